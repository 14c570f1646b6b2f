/* SPDX-License-Identifier: Apache-2.0 */
/* The first tests of fitted pixels of one tabulated delay, one in each lane: whether there is a surface
 * at all (detection.py is the definition), and the screen of whether one surface explains the counts
 * (assessment.py). Both are made at the bins of the search. */

typedef struct {
    const float *contrasts;  /* contrasts × bands */
    const float *curvatures; /* bands */
    const float *moments;    /* points × 2: mean and variance of a count's deviance */
} AssessmentTables;

INLINE vec cube_root(vec x)
{
    ivec positive = x > 1e-30f, bits;
    x = choose(positive, x, fill(1.0f));
    vec third = __builtin_convertvector((ivec)x, vec) * (1.0f / 3);
    bits = __builtin_convertvector(third, ivec) + 709921077;
    vec y = (vec)bits; /* to some per cent; Halley's steps cube the error */
    for (int i = 0; i < 3; i++) {
        vec cube = y * y * y;
        y *= (cube + 2.0f * x) / (2.0f * cube + x);
    }
    return choose(positive, y, (vec){0});
}

/* Standard normal scores of gamma variates over their mean (Wilson and Hilferty). */
INLINE vec gamma_scores(vec ratio, vec shape)
{
    return (cube_root(ratio) - (1.0f - 1.0f / (9.0f * shape))) * root(9.0f * shape);
}

/* Scores of the quadratic form of one or two directions. `dd_raw` and `ee_raw` are their variances
 * before they were made orthogonal: where little is left of one, it says nothing. */
INLINE vec contrast_scores(const FitRules *rules, vec d, vec e, vec dd, vec de, vec ee, vec dd_raw,
                           vec ee_raw)
{
    ivec usable = dd > rules->distinct * dd_raw;
    dd = choose(usable, dd, fill(1.0f));
    vec first = choose(usable, d * d / dd, (vec){0}), single = gamma_scores(first, fill(0.5f));
    if (rules->contrasts < 2)
        return single;
    vec share = de / dd, rest = ee - share * de;
    ivec distinct = usable & (rest > rules->distinct * ee_raw);
    vec second = e - share * d;
    second *= second / choose(distinct, rest, fill(1.0f));
    return choose(distinct, gamma_scores(0.5f * (first + second), fill(1.0f)), single);
}

/* First and last tabulated delay of the second derivative; returns 1 ÷ their distance. */
INLINE float around(const ModelTables *tables, int phase, int *before, int *after)
{
    const DelayTables *level = &tables->wide;
    int reach = tables->rules.reach;
    *before = phase > reach ? phase - reach : 0;
    *after = phase + reach < level->phases ? phase + reach : level->phases - 1;
    return 1 / ((float)(*after - *before) * level->phase_ns);
}

/* Expected counts of pulses alone in every bin. */
INLINE void expect_pulses(const DelayTables *level, int phase, const vec *amplitudes, vec *means)
{
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        const Lit *lit = level->lit + segment->lit;
        for (int v = 0; v < segment->bins; v++) {
            vec mean = {0};
            for (int j = 0; j < segment->bands; j++)
                mean += amplitudes[lit[j].band] * level->data[lit[j].shares + v];
            means[segment->bin + v] = mean;
        }
    }
}

/* Twice the log-likelihood ratio of the fit against background alone. */
INLINE vec likelihood_ratios(const ModelTables *tables, const vec *counts, const vec *pulses,
                             vec total, vec background)
{
    const DelayTables *level = &tables->wide;
    vec flat = greater(background, tables->rules.detection_share * total), whole = {0}, gain = {0};
    for (int v = 0; v < level->bins; v++)
        whole += pulses[v] + flat * level->widths[v] + LEAST;
    vec scale = 1.0f / whole;
    for (int v = 0; v < level->bins; v++) {
        vec mean = pulses[v] + flat * level->widths[v] + LEAST;
        vec share = mean * scale / (level->widths[v] + LEAST) + LEAST;
        gain += choose(counts[v] > 0.0f, counts[v] * logarithm(share), (vec){0});
    }
    return 2.0f * gain;
}

/* Σ a_k T'_k·pull at a tabulated delay. */
INLINE vec slopes_along(const DelayTables *level, int phase, const vec *amplitudes, const vec *pulls)
{
    vec whole = {0};
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        for (int j = 0; j < segment->bands; j++) {
            Lit lit = level->lit[segment->lit + j];
            vec own = {0};
            for (int v = 0; v < segment->bins; v++)
                own += pulls[segment->bin + v] * level->data[lit.slopes + v];
            whole += amplitudes[lit.band] * own;
        }
    }
    return whole;
}

/* Pull on each band's delay, and the information about it, both for an amplitude of 1. */
INLINE void pull_bands(const ModelTables *tables, int phase, const vec *weights, const vec *pulls,
                       vec *pull, vec *information)
{
    const DelayTables *level = &tables->wide;
    memset(pull, 0, sizeof *pull * (size_t)tables->bands);
    memset(information, 0, sizeof *pull * (size_t)tables->bands);
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        for (int j = 0; j < segment->bands; j++) {
            Lit lit = level->lit[segment->lit + j];
            vec u = {0}, w = {0};
            for (int v = 0; v < segment->bins; v++) {
                float slope = level->data[lit.slopes + v];
                u += pulls[segment->bin + v] * slope;
                w += weights[segment->bin + v] * (slope * slope);
            }
            pull[lit.band] += u;
            information[lit.band] += w;
        }
    }
}

/* Greatest scores of the screen, and Pearson's χ² per degree of freedom. `work` has room for two
 * vectors a bin. */
INLINE vec screen(const ModelTables *tables, const AssessmentTables *tests, int phase,
                  const vec *counts, const vec *pulses, const vec *amplitudes, vec background,
                  vec *work, vec *chi_square)
{
    const DelayTables *level = &tables->wide;
    int bands = tables->bands, contrasts = tables->rules.contrasts, before, after;
    vec *weights = work, *pulls = work + level->bins, chi = {0}, odd = {0};
    vec flat = greater(background, fill(tables->rules.least_background));
    for (int v = 0; v < level->bins; v++) {
        vec mean = pulses[v] + flat * level->widths[v] + LEAST, residual = counts[v] - mean;
        weights[v] = reciprocal(mean);
        pulls[v] = weights[v] * residual;
        chi += pulls[v] * residual;
        odd += weights[v];
    }
    vec pull[MOST_BANDS], information[MOST_BANDS];
    pull_bands(tables, phase, weights, pulls, pull, information);
    vec t = {0}, d = {0}, e = {0}, tt = {0}, td = {0}, te = {0}, dd = {0}, de = {0}, ee = {0}, qq = {0};
    for (int k = 0; k < bands; k++) {
        float first = contrasts > 0 ? tests->contrasts[k] : 0;
        float second = contrasts > 1 ? tests->contrasts[bands + k] : 0;
        vec u = amplitudes[k] * pull[k], v = amplitudes[k] * amplitudes[k] * information[k];
        t += u;
        d += first * u;
        e += second * u;
        tt += v;
        td += first * v;
        te += second * v;
        dd += first * first * v;
        de += first * second * v;
        ee += second * second * v;
        qq += tests->curvatures[k] * v;
    }
    float apart = around(tables, phase, &before, &after);
    vec broad = apart * (slopes_along(level, after, amplitudes, pulls)
                         - slopes_along(level, before, amplitudes, pulls));
    vec score = broad / root(qq + LEAST), shift = t / (tt + LEAST);
    float freedom = (float)(level->bins - bands - 2);
    *chi_square = fill(NAN);
    if (freedom > 0) {
        *chi_square = (chi - t * shift) / freedom;
        vec shape = freedom * freedom / (2.0f * freedom + odd);
        score = greater(score, gamma_scores(*chi_square, shape));
    }
    if (contrasts)
        score = greater(score, contrast_scores(&tables->rules, d - td * shift, e - te * shift,
                                               dd - td * td / (tt + LEAST),
                                               de - td * te / (tt + LEAST),
                                               ee - te * te / (tt + LEAST), dd, ee));
    return score;
}
