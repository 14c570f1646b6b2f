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

/* What is summed over bins for all bands together. S is the derivative by the delay, Q that along
 * broader pulses, D and E those along the two contrasts, R the residual, W the background. */
enum { A_SS, A_SW, A_WW, A_SR, A_WR, A_SQ, A_WQ, A_QQ, A_QR, A_SD, A_WD, A_DD, A_DR, A_SE, A_WE, A_EE,
       A_ER, A_DE, A_COMMON };
/* And for each band, T being its share. */
enum { A_TT, A_TW, A_TS, A_TR, A_TQ, A_TD, A_TE, A_SUMS };

/* Right sides of the normal equations. */
enum { TO_R, TO_Q, TO_D, TO_E, SIDES };

typedef struct {
    vec sides[SIDES][MOST_SIZE];    /* weighted products of the nuisances with R, Q, D, E */
    vec solved[SIDES][MOST_SIZE];   /* and what the inverse makes of them */
    vec covariance[MOST_SIZE * (MOST_SIZE + 1) / 2];
    vec qq, qr, dd, dr, ee, er, de;
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

/* Adds the weighted products of the shares of every two bands to the lane of the equations. */
INLINE void add_pairs(const DelayTables *level, int phase, const float *weights, Equations *into,
                      int lane)
{
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        const Lit *lit = level->lit + segment->lit;
        for (int j = 1; j < segment->bands; j++)
            for (int k = 0; k < j; k++) {
                float both = 0;
                for (int v = 0; v < segment->bins; v++)
                    both += weights[segment->bin + v] * level->data[lit[j].shares + v]
                          * level->data[lit[k].shares + v];
                into->normal[AT(lit[j].band, lit[k].band)][lane] += both;
            }
    }
}

/* Sums of one pixel into its lane. `work` has room for six vectors a block. */
INLINE void project(const ModelTables *tables, const AssessmentTables *tests,
                    const float *counts, const Fitted *fitted, int phase, vec *work,
                    Equations *into, Projections *to, int lane)
{
    const DelayTables *level = &tables->wide;
    const float *amplitudes = fitted->amplitudes;
    float background = fitted->background;
    int bands = tables->bands, contrasts = tables->rules.contrasts;
    int blocks = level->blocks;
    vec *means = work, *slopes = means + blocks, *curves = slopes + blocks, *first = curves + blocks;
    vec *second = first + blocks, *residuals = second + blocks;
    for (int v = 0; v < blocks; v++)
        means[v] = background * load(level->widths + v * LANES) + LEAST;
    memset(slopes, 0, sizeof(vec) * 4 * (size_t)blocks);
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
            first[at] += d * slope;
            second[at] += e * slope;
        }
    }
    int before, after;
    float apart = around(tables, phase, &before, &after);
    add_slopes(level, after, amplitudes, apart, curves);
    add_slopes(level, before, amplitudes, -apart, curves);

    vec all[A_COMMON + MOST_BANDS * A_SUMS + LANES], *own = all + A_COMMON;
    int used = A_COMMON + bands * A_SUMS;
    memset(all, 0, sizeof *all * (size_t)(used + LANES));
    for (int v = 0; v < blocks; v++) {
        vec w = 1.0f / means[v], width = load(level->widths + v * LANES);
        vec s = slopes[v], q = curves[v], d = first[v], e = second[v];
        vec ws = w * s, wq = w * q, wd = w * d, we = w * e, ww = w * width;
        vec r = load(counts + v * LANES) - means[v], wr = w * r;
        all[A_SS] += ws * s;
        all[A_SW] += ws * width;
        all[A_WW] += ww * width;
        all[A_SR] += ws * r;
        all[A_WR] += ww * r;
        all[A_SQ] += ws * q;
        all[A_WQ] += ww * q;
        all[A_QQ] += wq * q;
        all[A_QR] += wq * r;
        all[A_SD] += ws * d;
        all[A_WD] += ww * d;
        all[A_DD] += wd * d;
        all[A_DR] += wd * r;
        all[A_SE] += ws * e;
        all[A_WE] += ww * e;
        all[A_EE] += we * e;
        all[A_ER] += we * r;
        all[A_DE] += wd * e;
        means[v] = w;
        slopes[v] = ws;
        curves[v] = wq;
        first[v] = wd;
        second[v] = we;
        residuals[v] = wr;
    }
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        vec tt = {0}, tw = {0}, ts = {0}, tr = {0}, tq = {0}, td = {0}, te = {0};
        for (int v = 0; v * LANES < run.bins; v++) {
            int at = run.bin / LANES + v;
            vec t = load(shares + v * LANES), wt = means[at] * t;
            tt += wt * t;
            tw += wt * load(level->widths + at * LANES);
            ts += t * slopes[at];
            tr += t * residuals[at];
            tq += t * curves[at];
            td += t * first[at];
            te += t * second[at];
        }
        vec *mine = own + run.band * A_SUMS;
        mine[A_TT] += tt;
        mine[A_TW] += tw;
        mine[A_TS] += ts;
        mine[A_TR] += tr;
        mine[A_TQ] += tq;
        mine[A_TD] += td;
        mine[A_TE] += te;
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
        to->sides[TO_Q][k][lane] = band[A_TQ];
        to->sides[TO_D][k][lane] = band[A_TD];
        to->sides[TO_E][k][lane] = band[A_TE];
    }
    add_pairs(level, phase, (const float *)means, into, lane);
    into->normal[AT(b, b)][lane] = made[A_WW];
    into->normal[AT(t, b)][lane] = made[A_SW];
    into->normal[AT(t, t)][lane] = made[A_SS];
    to->sides[TO_R][b][lane] = made[A_WR];
    to->sides[TO_R][t][lane] = made[A_SR];
    to->sides[TO_Q][b][lane] = made[A_WQ];
    to->sides[TO_Q][t][lane] = made[A_SQ];
    to->sides[TO_D][b][lane] = made[A_WD];
    to->sides[TO_D][t][lane] = made[A_SD];
    to->sides[TO_E][b][lane] = made[A_WE];
    to->sides[TO_E][t][lane] = made[A_SE];
    to->qq[lane] = made[A_QQ];
    to->qr[lane] = made[A_QR];
    to->dd[lane] = made[A_DD];
    to->dr[lane] = made[A_DR];
    to->ee[lane] = made[A_EE];
    to->er[lane] = made[A_ER];
    to->de[lane] = made[A_DE];
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

/* Skewness sum of the broadening test, and the deviance with its mean and variance, of one lane. */
typedef struct {
    float cubed, deviance, mean, variance;
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
    vec *means = work, *slopes = means + blocks, *curves = slopes + blocks, *moved = curves + blocks;
    vec *aside = moved + blocks, *leverage = aside + blocks;
    float step_t = to->solved[TO_R][t][lane], turn_t = to->solved[TO_Q][t][lane];
    float step_b = to->solved[TO_R][b][lane], turn_b = to->solved[TO_Q][b][lane];
    for (int v = 0; v < blocks; v++) {
        vec width = load(level->widths + v * LANES);
        means[v] = background * width + LEAST;
        moved[v] = step_b * width;
        aside[v] = turn_b * width;
        slopes[v] = curves[v] = (vec){0};
    }
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place;
        const float *steep = shares + run.bins;
        float a = amplitudes[run.band], step = to->solved[TO_R][run.band][lane];
        float turn = to->solved[TO_Q][run.band][lane];
        for (int v = 0; v * LANES < run.bins; v++) {
            int at = run.bin / LANES + v;
            vec share = load(shares + v * LANES);
            means[at] += a * share;
            moved[at] += step * share;
            aside[at] += turn * share;
            slopes[at] += a * load(steep + v * LANES);
        }
    }
    int before, after;
    float apart = around(tables, phase, &before, &after);
    add_slopes(level, after, amplitudes, apart, curves);
    add_slopes(level, before, amplitudes, -apart, curves);
    const vec *c = to->covariance;
    float bb = c[AT(b, b)][lane], tb = 2 * c[AT(t, b)][lane], tt = c[AT(t, t)][lane];
    for (int v = 0; v < blocks; v++) {
        vec width = load(level->widths + v * LANES), s = slopes[v];
        leverage[v] = width * (bb * width + tb * s) + tt * s * s;
        moved[v] += means[v] + step_t * s;
        aside[v] = curves[v] - aside[v] - turn_t * s;
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
    vec cubed = {0}, deviance = {0}, mean = {0}, variance = {0};
    vec last = fill((float)(rules->points - 1));
    for (int v = 0; v < blocks; v++) {
        vec w = 1.0f / means[v], x = aside[v];
        cubed += x * x * x * w * w;
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
    return (Second){sum(cubed), sum(deviance) / 2, sum(mean) / 2, sum(variance) / 2};
}

/* Full tests of at most as many pixels as there are lanes: their numbers, and by number their counts,
 * delays in the pixel and tracks. */
APART vec full_scores(const ModelTables *tables, const AssessmentTables *tests, const float *counts,
                       size_t stride, const float *arrivals, const float *tracks, const int32_t *which,
                       int count, vec *work, Equations *equations)
{
    int bands = tables->bands, size = bands + 2, contrasts = tables->rules.contrasts;
    Fitted fitted[LANES];
    Projections to;
    for (int side = 0; side < SIDES; side++) /* zeros are of lanes that are left over */
        memset(to.sides[side], 0, sizeof(vec) * (size_t)size);
    to.qq = to.qr = to.dd = to.dr = to.ee = to.er = to.de = (vec){0};
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
    solve_sides(equations, &to, size, 2 + contrasts, tables->rules.ridge);
    vec variance = to.qq - product(to.solved[TO_Q], to.sides[TO_Q], size) + LEAST;
    vec z = (to.qr - product(to.solved[TO_Q], to.sides[TO_R], size)) / root(variance);
    float cubed[LANES] = {0}, deviance[LANES] = {0}, mean[LANES], spread[LANES];
    for (int lane = 0; lane < LANES; lane++)
        mean[lane] = spread[lane] = 1;
    for (int lane = 0; lane < count; lane++) {
        int p = which[lane];
        Second second = second_pass(tables, tests, counts + (size_t)p * stride, &fitted[lane],
                                    phase_of(&tables->wide, arrivals[p]), work, &to, lane);
        cubed[lane] = second.cubed;
        deviance[lane] = second.deviance;
        mean[lane] = second.mean + LEAST;
        spread[lane] = second.variance + LEAST;
    }
    vec score = z - load(cubed) / (variance * root(variance)) * (z * z - 1.0f) / 6.0f;
    if (contrasts) {
        vec dd = to.dd - product(to.solved[TO_D], to.sides[TO_D], size);
        vec dr = to.dr - product(to.solved[TO_D], to.sides[TO_R], size);
        vec ee = {0}, er = {0}, de = {0};
        if (contrasts > 1) {
            ee = to.ee - product(to.solved[TO_E], to.sides[TO_E], size);
            er = to.er - product(to.solved[TO_E], to.sides[TO_R], size);
            de = to.de - product(to.solved[TO_D], to.sides[TO_E], size);
        }
        score = greater(score, contrast_scores(&tables->rules, dr, er, dd, de, ee, to.dd,
                                               to.ee));
    }
    vec shape = load(mean) * load(mean) / load(spread);
    return greater(score, gamma_scores(load(deviance) / load(mean), shape));
}

