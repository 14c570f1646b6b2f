/* SPDX-License-Identifier: Apache-2.0 */
/* The full test of whether one surface explains a fitted pixel's counts; see assessment.py, which is the
 * definition. Few pixels get it: sums over bins are made one pixel at a time, a vector of bins at
 * once; what follows from them is computed for as many pixels as there are lanes. */

typedef struct {
    float amplitudes[MOST_BANDS], background;
} Fitted;

INLINE Fitted fitted_of(const ModelTables *tables, const float *track)
{
    Fitted fitted;
    for (int k = 0; k < tables->bands; k++)
        fitted.amplitudes[k] = track[AT_AMPLITUDES + k] > 0 ? track[AT_AMPLITUDES + k] : 0;
    float least = tables->rules.least_background;
    fitted.background = track[AT_BACKGROUND] > least ? track[AT_BACKGROUND] : least;
    return fitted;
}

/* Directions of the tests: broader pulses, light that is earlier or later, delays along the two
 * contrasts. The first three are corrected for skewness. */
enum { BROADER, EARLIER, LATER, SKEWED, FIRST = SKEWED, SECOND, DIRECTIONS };

/* What is summed over bins for all bands together. S is the derivative by the delay, R the residual,
 * W the background, X each direction. */
enum { A_SS, A_SW, A_WW, A_SR, A_WR, A_SX, A_WX = A_SX + DIRECTIONS, A_XX = A_WX + DIRECTIONS,
       A_XR = A_XX + DIRECTIONS, A_FIRST_BROADER = A_XR + DIRECTIONS, A_SECOND_BROADER, A_COMMON };
/* And for each band, T being its share. */
enum { A_TT, A_TW, A_TS, A_TR, A_TX, A_SUMS = A_TX + DIRECTIONS };

/* Right sides of the normal equations: the residual, then every direction. */
enum { TO_R, TO_X, SIDES = TO_X + DIRECTIONS };

typedef struct {
    vec sides[SIDES][MOST_SIZE];    /* weighted products of the nuisances with R and X */
    vec solved[SIDES][MOST_SIZE];   /* and what the inverse makes of them */
    vec covariance[MOST_SIZE * (MOST_SIZE + 1) / 2];
    vec xx[DIRECTIONS], xr[DIRECTIONS], broader[2]; /* of directions; of contrasts and BROADER */
} Projections;

/* Adds to `curves` the pulses' slopes at a delay, scaled. */
INLINE void add_slopes(const DelayTables *level, int phase, const float *amplitudes, float scale,
                       vec *curves)
{
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *slopes = level->data + run.place + run.bins;
        float a = scale * amplitudes[run.band];
        for (int v = 0; v < run.bins; v += LANES)
            curves[(run.bin + v) / LANES] += a * load(slopes + v);
    }
}

/* Adds the pulses at a delay. */
INLINE void add_shares(const DelayTables *level, int phase, const float *amplitudes, vec *pulses)
{
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        float a = amplitudes[run.band];
        for (int v = 0; v < run.bins; v += LANES)
            pulses[(run.bin + v) / LANES] += a * load(shares + v);
    }
}

/* Adds the directions that are corrected for skewness, each from its array. */
INLINE void add_skewed(const ModelTables *tables, int phase, const float *amplitudes, vec *const *into)
{
    const DelayTables *level = &tables->wide;
    int before, after, lag = tables->rules.lag, last = level->phases - 1;
    float apart = around(tables, phase, &before, &after);
    add_slopes(level, after, amplitudes, apart, into[BROADER]);
    add_slopes(level, before, amplitudes, -apart, into[BROADER]);
    add_shares(level, phase > lag ? phase - lag : 0, amplitudes, into[EARLIER]);
    add_shares(level, phase + lag < last ? phase + lag : last, amplitudes, into[LATER]);
}

/* Adds the weighted products of the shares of every two bands to the lane of the equations. */
INLINE void add_pairs(const DelayTables *level, int phase, const float *weights, Equations *into,
                      int lane)
{
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        const Lit *lit = level->lit + segment->lit;
        for (int j = 1; j < segment->bands; j++)
            for (int k = 0; k < j; k++) {
                const float *first = level->data + lit[j].shares, *second = level->data + lit[k].shares;
                const float *weight = weights + segment->bin;
                float both = 0, odd = 0; /* two sums, as each waits for its last */
                int v = 0;
                for (; v + 1 < segment->bins; v += 2) {
                    both += weight[v] * first[v] * second[v];
                    odd += weight[v + 1] * first[v + 1] * second[v + 1];
                }
                if (v < segment->bins)
                    both += weight[v] * first[v] * second[v];
                into->normal[AT(lit[j].band, lit[k].band)][lane] += both + odd;
            }
    }
}

/* Sums of one pixel into its lane. `work` has room for eight vectors a block. */
INLINE void project(const ModelTables *tables, const AssessmentTables *tests,
                    const float *counts, const Fitted *fitted, int phase, vec *work,
                    Equations *into, Projections *to, int lane)
{
    const DelayTables *level = &tables->wide;
    const float *amplitudes = fitted->amplitudes;
    int bands = tables->bands, contrasts = tables->rules.contrasts, blocks = level->blocks;
    vec *means = work, *slopes = means + blocks, *residuals = slopes; /* in place of the slopes */
    vec *x[DIRECTIONS];
    for (int d = 0; d < DIRECTIONS; d++)
        x[d] = slopes + (size_t)(d + 1) * (size_t)blocks;
    for (int v = 0; v < blocks; v++)
        means[v] = fitted->background * load(level->widths + v * LANES) + LEAST;
    memset(slopes, 0, sizeof(vec) * (DIRECTIONS + 1) * (size_t)blocks);
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        const float *steep = shares + run.bins;
        float a = amplitudes[run.band];
        float d = contrasts > 0 ? a * tests->contrasts[run.band] : 0;
        float e = contrasts > 1 ? a * tests->contrasts[bands + run.band] : 0;
        for (int v = 0; v * LANES < run.bins; v++) {
            int at = run.bin / LANES + v;
            vec slope = load(steep + v * LANES);
            means[at] += a * load(shares + v * LANES);
            slopes[at] += a * slope;
            x[FIRST][at] += d * slope;
            x[SECOND][at] += e * slope;
        }
    }
    add_skewed(tables, phase, amplitudes, x);

    vec all[A_COMMON + MOST_BANDS * A_SUMS + LANES], *own = all + A_COMMON;
    int used = A_COMMON + bands * A_SUMS;
    memset(all, 0, sizeof *all * (size_t)(used + LANES));
    vec *weighted_slopes = x[DIRECTIONS - 1] + blocks;
    for (int v = 0; v < blocks; v++) {
        vec w = 1.0f / means[v], width = load(level->widths + v * LANES);
        vec s = slopes[v], ws = w * s, ww = w * width, broader = x[BROADER][v];
        vec r = load(counts + v * LANES) - means[v];
        all[A_SS] += ws * s;
        all[A_SW] += ws * width;
        all[A_WW] += ww * width;
        all[A_SR] += ws * r;
        all[A_WR] += ww * r;
        all[A_FIRST_BROADER] += w * broader * x[FIRST][v];
        all[A_SECOND_BROADER] += w * broader * x[SECOND][v];
        for (int d = 0; d < DIRECTIONS; d++) {
            vec own_x = x[d][v], weighted = w * own_x;
            all[A_SX + d] += weighted * s;
            all[A_WX + d] += weighted * width;
            all[A_XX + d] += weighted * own_x;
            all[A_XR + d] += weighted * r;
            x[d][v] = weighted;
        }
        means[v] = w;
        weighted_slopes[v] = ws;
        residuals[v] = w * r;
    }
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        vec tt = {0}, tw = {0}, ts = {0}, tr = {0}, tx[DIRECTIONS] = {{0}};
        for (int v = 0; v * LANES < run.bins; v++) {
            int at = run.bin / LANES + v;
            vec t = load(shares + v * LANES), wt = means[at] * t;
            tt += wt * t;
            tw += wt * load(level->widths + at * LANES);
            ts += t * weighted_slopes[at];
            tr += t * residuals[at];
            for (int d = 0; d < DIRECTIONS; d++)
                tx[d] += t * x[d][at];
        }
        vec *mine = own + run.band * A_SUMS;
        mine[A_TT] += tt;
        mine[A_TW] += tw;
        mine[A_TS] += ts;
        mine[A_TR] += tr;
        for (int d = 0; d < DIRECTIONS; d++)
            mine[A_TX + d] += tx[d];
    }
    float made[(A_COMMON + MOST_BANDS * A_SUMS) / LANES * LANES + LANES];
    for (int i = 0; i < used; i += LANES)
        store(made + i, sums(all + i));

    int b = bands, t = bands + 1;
    const float *band = made + A_COMMON;
    for (int k = 0; k < bands; k++, band += A_SUMS) {
        into->normal[AT(k, k)][lane] = band[A_TT];
        into->normal[AT(b, k)][lane] = band[A_TW];
        into->normal[AT(t, k)][lane] = band[A_TS];
        to->sides[TO_R][k][lane] = band[A_TR];
        for (int d = 0; d < DIRECTIONS; d++)
            to->sides[TO_X + d][k][lane] = band[A_TX + d];
    }
    add_pairs(level, phase, (const float *)means, into, lane);
    into->normal[AT(b, b)][lane] = made[A_WW];
    into->normal[AT(t, b)][lane] = made[A_SW];
    into->normal[AT(t, t)][lane] = made[A_SS];
    to->sides[TO_R][b][lane] = made[A_WR];
    to->sides[TO_R][t][lane] = made[A_SR];
    for (int d = 0; d < DIRECTIONS; d++) {
        to->sides[TO_X + d][b][lane] = made[A_WX + d];
        to->sides[TO_X + d][t][lane] = made[A_SX + d];
        to->xx[d][lane] = made[A_XX + d];
        to->xr[d][lane] = made[A_XR + d];
    }
    to->broader[0][lane] = made[A_FIRST_BROADER];
    to->broader[1][lane] = made[A_SECOND_BROADER];
}

/* What the inverse of all lanes' normal matrices makes of the right sides, and the inverse itself. */
INLINE void solve_sides(Equations *e, Projections *to, int size, int sides, float ridge)
{
    for (int i = 0; i < size; i++) { /* a band whose pulse is nowhere */
        e->normal[AT(i, i)] = greater(e->normal[AT(i, i)], fill(1e-30f));
        e->right[i] = (vec){0};
    }
    solve(e, size, ridge); /* leaves the inverse's lower factor in place of the matrix */
    for (int side = 0; side < sides; side++) {
        vec half[MOST_SIZE];
        for (int i = 0; i < size; i++) {
            half[i] = (vec){0};
            for (int k = 0; k <= i; k++)
                half[i] += e->normal[AT(i, k)] * to->sides[side][k];
        }
        for (int i = 0; i < size; i++) {
            vec x = {0};
            for (int k = i; k < size; k++)
                x += e->normal[AT(k, i)] * half[k];
            to->solved[side][i] = x;
        }
    }
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++) {
            vec x = {0};
            for (int k = i; k < size; k++)
                x += e->normal[AT(k, i)] * e->normal[AT(k, j)];
            to->covariance[AT(i, j)] = x;
        }
}

INLINE vec product(const vec *a, const vec *b, int size)
{
    vec x = {0};
    for (int i = 0; i < size; i++)
        x += a[i] * b[i];
    return x;
}

/* Skewness sums of directions, and the deviance with its mean and variance, of one lane. */
typedef struct {
    float cubed[SKEWED], deviance, mean, variance;
} Second;

INLINE Second second_pass(const ModelTables *tables, const AssessmentTables *tests,
                          const float *counts, const Fitted *fitted, int phase, vec *work,
                          const Projections *to, int lane)
{
    const DelayTables *level = &tables->wide;
    const FitRules *rules = &tables->rules;
    const float *amplitudes = fitted->amplitudes;
    float background = fitted->background;
    int bands = tables->bands, blocks = level->blocks, b = bands, t = bands + 1;
    vec *means = work, *slopes = means + blocks, *moved = slopes + blocks, *leverage = moved + blocks;
    vec *aside[SKEWED];
    float step_t = to->solved[TO_R][t][lane], step_b = to->solved[TO_R][b][lane];
    float turn_t[SKEWED], turn_b[SKEWED];
    for (int d = 0; d < SKEWED; d++) {
        aside[d] = leverage + (size_t)(d + 1) * (size_t)blocks;
        turn_t[d] = to->solved[TO_X + d][t][lane];
        turn_b[d] = to->solved[TO_X + d][b][lane];
    }
    for (int v = 0; v < blocks; v++) {
        vec width = load(level->widths + v * LANES);
        means[v] = background * width + LEAST;
        moved[v] = step_b * width;
        for (int d = 0; d < SKEWED; d++)
            aside[d][v] = -turn_b[d] * width;
        slopes[v] = (vec){0};
    }
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        const float *steep = shares + run.bins;
        float a = amplitudes[run.band], step = to->solved[TO_R][run.band][lane];
        float turn[SKEWED];
        for (int d = 0; d < SKEWED; d++)
            turn[d] = to->solved[TO_X + d][run.band][lane];
        for (int v = 0; v * LANES < run.bins; v++) {
            int at = run.bin / LANES + v;
            vec share = load(shares + v * LANES);
            means[at] += a * share;
            moved[at] += step * share;
            for (int d = 0; d < SKEWED; d++)
                aside[d][at] -= turn[d] * share;
            slopes[at] += a * load(steep + v * LANES);
        }
    }
    add_skewed(tables, phase, amplitudes, aside);
    const vec *c = to->covariance;
    float bb = c[AT(b, b)][lane], tb = 2 * c[AT(t, b)][lane], tt = c[AT(t, t)][lane];
    for (int v = 0; v < blocks; v++) {
        vec width = load(level->widths + v * LANES), s = slopes[v];
        leverage[v] = width * (bb * width + tb * s) + tt * s * s;
        moved[v] += means[v] + step_t * s;
        for (int d = 0; d < SKEWED; d++)
            aside[d][v] -= turn_t[d] * s;
    }
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        int k = run.band;
        float kk = c[AT(k, k)][lane], bk = 2 * c[AT(b, k)][lane], tk = 2 * c[AT(t, k)][lane];
        for (int v = 0; v * LANES < run.bins; v++) {
            int at = run.bin / LANES + v;
            vec share = load(shares + v * LANES);
            leverage[at] += share * (kk * share + bk * load(level->widths + at * LANES)
                                     + tk * slopes[at]);
        }
    }
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        const Lit *lit = level->lit + segment->lit;
        float *both = (float *)leverage + segment->bin;
        for (int j = 1; j < segment->bands; j++)
            for (int k = 0; k < j; k++) {
                float jk = 2 * c[AT(lit[j].band, lit[k].band)][lane];
                for (int v = 0; v < segment->bins; v++)
                    both[v] += jk * level->data[lit[j].shares + v] * level->data[lit[k].shares + v];
            }
    }
    vec cubed[SKEWED] = {{0}}, deviance = {0}, mean = {0}, variance = {0};
    vec last = fill((float)(rules->points - 1));
    for (int v = 0; v < blocks; v++) {
        vec w = 1.0f / means[v];
        for (int d = 0; d < SKEWED; d++)
            cubed[d] += aside[d][v] * aside[d][v] * aside[d][v] * w * w;
        /* groups of two bins: both lanes of a pair hold its sums, and half of what they give counts */
        vec h = load(counts + v * LANES), mu = moved[v], lev = leverage[v] * w;
        h += swap(h, 1);
        mu += swap(mu, 1);
        lev += swap(lev, 1);
        ivec there = load(level->widths + v * LANES) > 0.0f;
        there |= (ivec)swap((vec)there, 1);
        mu = greater(mu, fill(rules->least_mean));
        vec part = 2.0f * (mu - h);
        part += choose(h > 0.0f, 2.0f * h * logarithm(greater(h, fill(1.0f)) / mu), (vec){0});
        vec left = 1.0f - lev;
        left = choose(left > 1.0f, fill(1.0f), greater(left, (vec){0}));
        left = choose(there, left, (vec){0});
        vec at = (logarithm(mu) - rules->first_log) / rules->log_step;
        at = greater(choose(at < last, at, last), (vec){0});
        ivec place = __builtin_convertvector(at, ivec);
        ivec most = (ivec){0} + (rules->points - 2);
        place = ((place < most) & place) | ((place >= most) & most);
        vec share = at - __builtin_convertvector(place, vec);
        int32_t places[LANES];
        float found[4][LANES];
        memcpy(places, &place, sizeof places);
        for (int i = 0; i < LANES; i += 2) { /* both lanes of a pair are alike */
            const float *moments = tests->moments + 2 * places[i];
            for (int j = 0; j < 4; j++)
                found[j][i] = found[j][i + 1] = moments[j];
        }
        deviance += choose(there, part, (vec){0});
        mean += left * (load(found[0]) + share * (load(found[2]) - load(found[0])));
        variance += left * (load(found[1]) + share * (load(found[3]) - load(found[1])));
    }
    Second second = {{0}, sum(deviance) / 2, sum(mean) / 2, sum(variance) / 2};
    for (int d = 0; d < SKEWED; d++)
        second.cubed[d] = sum(cubed[d]);
    return second;
}

/* Greatest score of the directions that are corrected for skewness. */
INLINE vec skewed_scores(const FitRules *rules, const vec *xx, const vec *xr, const vec *raw,
                         float cubed[SKEWED][LANES])
{
    vec score = fill(-INFINITY);
    for (int d = 0; d < SKEWED; d++) {
        vec variance = xx[d] + LEAST, z = xr[d] / root(variance);
        z -= load(cubed[d]) / (variance * root(variance)) * (z * z - 1.0f) / 6.0f;
        z -= d == BROADER ? 0 : rules->lag_allowance;
        score = greater(score, choose(variance > rules->distinct * raw[d], z, score));
    }
    return score;
}

/* Greatest score of delays along the contrasts, in either direction, with broader pulses. */
INLINE vec sided_scores(const FitRules *rules, const vec *xx, const vec *xr, const vec *raw,
                        const vec *broader)
{
    const float parts[2] = {rules->first_broadening, rules->second_broadening};
    const float allowances[2] = {rules->first_allowance, rules->second_allowance};
    vec score = fill(-INFINITY);
    for (int c = 0; c < rules->contrasts; c++) {
        int d = FIRST + c;
        ivec distinct = xx[d] > rules->distinct * raw[d];
        for (float sign = 1; sign > -2; sign -= 2) {
            vec pull = sign * xr[d] + parts[c] * xr[BROADER];
            vec variance = xx[d] + parts[c] * (parts[c] * xx[BROADER] + 2 * sign * broader[c]);
            vec z = pull / root(greater(variance, fill(LEAST))) - allowances[c];
            score = greater(score, choose(distinct, z, score));
        }
    }
    return score;
}

/* Full tests of at most as many pixels as there are lanes: their numbers, and by number their counts,
 * delays in the pixel and tracks. */
APART vec full_scores(const ModelTables *tables, const AssessmentTables *tests, const float *counts,
                       size_t stride, const float *arrivals, const float *tracks, const int32_t *which,
                       int count, vec *work, Equations *equations)
{
    int bands = tables->bands, size = bands + 2;
    Fitted fitted[LANES];
    Projections to;
    for (int side = 0; side < SIDES; side++) /* zeros are of lanes that are left over */
        memset(to.sides[side], 0, sizeof(vec) * (size_t)size);
    for (int d = 0; d < DIRECTIONS; d++)
        to.xx[d] = to.xr[d] = (vec){0};
    to.broader[0] = to.broader[1] = (vec){0};
    for (int i = 0; i < AT(size, 0); i++)
        equations->normal[i] = (vec){0};
    for (int i = 0; i < size; i++)
        equations->normal[AT(i, i)] = fill(1.0f);
    for (int lane = 0; lane < count; lane++) {
        int p = which[lane];
        fitted[lane] = fitted_of(tables, tracks + (size_t)p * track_room(bands));
        project(tables, tests, counts + (size_t)p * stride, &fitted[lane],
                phase_of(&tables->wide, arrivals[p]), work, equations, &to, lane);
    }
    solve_sides(equations, &to, size, SIDES, tables->rules.ridge);
    vec xx[DIRECTIONS], xr[DIRECTIONS], broader[2];
    for (int d = 0; d < DIRECTIONS; d++) {
        xx[d] = to.xx[d] - product(to.solved[TO_X + d], to.sides[TO_X + d], size);
        xr[d] = to.xr[d] - product(to.solved[TO_X + d], to.sides[TO_R], size);
    }
    for (int c = 0; c < 2; c++)
        broader[c] = to.broader[c] - product(to.solved[TO_X + FIRST + c], to.sides[TO_X + BROADER],
                                             size);
    float cubed[SKEWED][LANES] = {{0}}, deviance[LANES] = {0}, mean[LANES], spread[LANES];
    for (int lane = 0; lane < LANES; lane++)
        mean[lane] = spread[lane] = 1;
    for (int lane = 0; lane < count; lane++) {
        int p = which[lane];
        Second second = second_pass(tables, tests, counts + (size_t)p * stride, &fitted[lane],
                                    phase_of(&tables->wide, arrivals[p]), work, &to, lane);
        for (int d = 0; d < SKEWED; d++)
            cubed[d][lane] = second.cubed[d];
        deviance[lane] = second.deviance;
        mean[lane] = second.mean + LEAST;
        spread[lane] = second.variance + LEAST;
    }
    vec shape = load(mean) * load(mean) / load(spread);
    vec score = gamma_scores(load(deviance) / load(mean), shape) - tables->rules.deviance_allowance;
    score = greater(score, skewed_scores(&tables->rules, xx, xr, to.xx, cubed));
    return greater(score, sided_scores(&tables->rules, xx, xr, to.xx, broader));
}
