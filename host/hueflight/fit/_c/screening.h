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
    vec first = choose(usable, d * d / dd, (vec){0});
    if (rules->contrasts < 2)
        return gamma_scores(first, fill(0.5f));
    vec share = de / dd, rest = ee - share * de;
    ivec distinct = usable & (rest > rules->distinct * ee_raw);
    vec second = e - share * d;
    second *= second / choose(distinct, rest, fill(1.0f));
    return gamma_scores(choose(distinct, 0.5f * (first + second), first),
                        choose(distinct, fill(1.0f), fill(0.5f)));
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

/* First slope of the bins of a run that are lit. */
INLINE const float *lit_slopes(const DelayTables *level, const Run *run)
{
    return level->data + run->place + run->bins + run->lit_bin - run->bin;
}

/* Adds the slopes of a band at a tabulated delay, scaled, in bins that a run of it lights. */
INLINE void add_lit_slopes(const DelayTables *level, int phase, const Run *run, float scale, float *to)
{
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        const Run *other = level->runs + i;
        int other_end = other->lit_bin + other->lit_bins, end = run->lit_bin + run->lit_bins;
        int low = other->lit_bin > run->lit_bin ? other->lit_bin : run->lit_bin;
        int high = other_end < end ? other_end : end;
        if (other->band != run->band || low >= high)
            continue;
        const float *slopes = lit_slopes(level, other) + low - other->lit_bin;
        for (int v = 0; v < high - low; v++)
            to[low - run->lit_bin + v] += scale * slopes[v];
    }
}

/* Second derivatives of the shares at a tabulated delay, of all runs one after another, in the bins
 * that they light. */
APART void curve_runs(const ModelTables *tables, int phase, float *curves)
{
    const DelayTables *level = &tables->wide;
    int before, after;
    float apart = around(tables, phase, &before, &after);
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        const Run *run = level->runs + i;
        memset(curves, 0, sizeof *curves * (size_t)run->lit_bins);
        add_lit_slopes(level, after, run, apart, curves);
        add_lit_slopes(level, before, run, -apart, curves);
        curves += run->lit_bins;
    }
}

/* Pulls on each band's delay and width, and the information about its delay, for an amplitude of 1. */
typedef struct {
    vec delay[MOST_BANDS], width[MOST_BANDS], information[MOST_BANDS];
} Pulls;

INLINE void pull_bands(const ModelTables *tables, int phase, const float *curves, const vec *weights,
                       const vec *pulls, Pulls *to)
{
    const DelayTables *level = &tables->wide;
    size_t size = sizeof(vec) * (size_t)tables->bands;
    memset(to->delay, 0, size);
    memset(to->width, 0, size);
    memset(to->information, 0, size);
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        const Run *run = level->runs + i;
        const float *slopes = lit_slopes(level, run);
        const vec *pulled = pulls + run->lit_bin, *weighed = weights + run->lit_bin;
        vec u = {0}, w = {0}, c = {0}, u_odd = {0}, w_odd = {0}, c_odd = {0};
        int v = 0;
        for (; v + 1 < run->lit_bins; v += 2) {
            vec even = pulled[v], odd = pulled[v + 1];
            u += even * slopes[v];
            c += even * curves[v];
            w += weighed[v] * slopes[v] * slopes[v];
            u_odd += odd * slopes[v + 1];
            c_odd += odd * curves[v + 1];
            w_odd += weighed[v + 1] * slopes[v + 1] * slopes[v + 1];
        }
        if (v < run->lit_bins) {
            u += pulled[v] * slopes[v];
            c += pulled[v] * curves[v];
            w += weighed[v] * slopes[v] * slopes[v];
        }
        to->delay[run->band] += u + u_odd;
        to->width[run->band] += c + c_odd;
        to->information[run->band] += w + w_odd;
        curves += run->lit_bins;
    }
}

/* Weights and weighted residuals of bins, and their sums. */
typedef struct {
    vec *weights, *pulls;
    vec chi, weight; /* Σ of squared residuals by weight, and of weights */
} Weighed;

/* Weighs the bins of a segment that `lit_bands` bands light. */
INLINE void weigh_segment(const DelayTables *level, const Segment *segment, const vec *counts,
                          const vec *amplitudes, vec background, Weighed *to, const int lit_bands)
{
    enum { ROOM = 3 };
    const Lit *lit = level->lit + segment->lit;
    const float *widths = level->widths + segment->bin, *shares[ROOM];
    vec a[ROOM], chi = to->chi, sum = to->weight;
    vec *weights = to->weights + segment->bin, *pulls = to->pulls + segment->bin;
    counts += segment->bin;
#pragma GCC unroll 3
    for (int j = 0; j < lit_bands; j++) {
        shares[j] = level->data + lit[j].shares;
        a[j] = amplitudes[lit[j].band];
    }
    for (int v = 0; v < segment->bins; v++) {
        vec mean = background * widths[v] + LEAST;
#pragma GCC unroll 3
        for (int j = 0; j < lit_bands; j++)
            mean += a[j] * shares[j][v];
        vec weight = reciprocal(mean), residual = counts[v] - mean, pull = weight * residual;
        weights[v] = weight;
        pulls[v] = pull;
        chi += pull * residual;
        sum += weight;
    }
    to->chi = chi;
    to->weight = sum;
}

/* The same for any number of bands. */
APART void weigh_many(const DelayTables *level, const Segment *segment, const vec *counts,
                      const vec *amplitudes, vec background, Weighed *to)
{
    const Lit *lit = level->lit + segment->lit;
    for (int v = 0, bin = segment->bin; v < segment->bins; v++, bin++) {
        vec mean = background * level->widths[bin] + LEAST;
        for (int j = 0; j < segment->bands; j++)
            mean += amplitudes[lit[j].band] * level->data[lit[j].shares + v];
        vec weight = reciprocal(mean), residual = counts[bin] - mean;
        to->weights[bin] = weight;
        to->pulls[bin] = weight * residual;
        to->chi += to->pulls[bin] * residual;
        to->weight += weight;
    }
}

/* Weighs all bins at a tabulated delay. */
INLINE void weigh(const DelayTables *level, int phase, const vec *counts, const vec *amplitudes,
                  vec background, Weighed *to)
{
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        switch (segment->bands) {
        case 0: weigh_segment(level, segment, counts, amplitudes, background, to, 0); break;
        case 1: weigh_segment(level, segment, counts, amplitudes, background, to, 1); break;
        case 2: weigh_segment(level, segment, counts, amplitudes, background, to, 2); break;
        case 3: weigh_segment(level, segment, counts, amplitudes, background, to, 3); break;
        default: weigh_many(level, segment, counts, amplitudes, background, to);
        }
    }
}

/* Greatest scores of the screen, and Pearson's χ² per degree of freedom. `curves` are what
 * `curve_runs` makes; `work` has room for two vectors a bin. */
INLINE vec screen(const ModelTables *tables, const AssessmentTables *tests, int phase,
                  const float *curves, const vec *counts, const vec *amplitudes, vec background,
                  vec *work, vec *chi_square)
{
    const DelayTables *level = &tables->wide;
    int bands = tables->bands, contrasts = tables->rules.contrasts;
    Weighed weighed = {.weights = work, .pulls = work + level->bins};
    weigh(level, phase, counts, amplitudes,
          greater(background, fill(tables->rules.least_background)), &weighed);
    Pulls pulls;
    pull_bands(tables, phase, curves, weighed.weights, weighed.pulls, &pulls);
    vec broad = {0}, t = {0}, d = {0}, e = {0}, tt = {0}, td = {0}, te = {0}, dd = {0}, de = {0}, ee = {0}, qq = {0};
    for (int k = 0; k < bands; k++) {
        float first = contrasts > 0 ? tests->contrasts[k] : 0;
        float second = contrasts > 1 ? tests->contrasts[bands + k] : 0;
        vec u = amplitudes[k] * pulls.delay[k];
        vec v = amplitudes[k] * amplitudes[k] * pulls.information[k];
        broad += amplitudes[k] * pulls.width[k];
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
    vec score = broad / root(qq + LEAST), shift = t / (tt + LEAST);
    float freedom = (float)(level->bins - bands - 2);
    *chi_square = fill(NAN);
    if (freedom > 0) {
        *chi_square = (weighed.chi - t * shift) / freedom;
        vec shape = freedom * freedom / (2.0f * freedom + weighed.weight);
        score = greater(score, gamma_scores(*chi_square, shape) - tables->rules.deviance_allowance);
    }
    if (contrasts)
        score = greater(score, contrast_scores(&tables->rules, d - td * shift, e - te * shift,
                                               dd - td * td / (tt + LEAST),
                                               de - td * te / (tt + LEAST),
                                               ee - te * te / (tt + LEAST), dd, ee));
    return score;
}
