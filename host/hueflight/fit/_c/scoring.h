/* SPDX-License-Identifier: Apache-2.0 */
/* Fisher scoring of as many candidates as a vector has lanes: sums over bins for one candidate at a
 * time, a vector of bins at once; then the normal equations of all candidates, one in each lane. */

typedef struct {
    vec normal[MOST_SIZE * (MOST_SIZE + 1) / 2]; /* lower triangle, rows one after another */
    vec right[MOST_SIZE];
    vec cubic;
} Equations;

#define AT(row, col) ((row) * ((row) + 1) / 2 + (col))

INLINE int phase_of(const DelayTables *level, float delay)
{
    int phase = (int)rintf((delay - level->first_ns) / level->phase_ns);
    return phase < 0 ? 0 : phase >= level->phases ? level->phases - 1 : phase;
}

INLINE float floor_of(const FitRules *rules, float total)
{
    return rules->floor_photons + rules->floor_share * total;
}

/* Expected counts of all blocks, and with `slopes` their derivative by the delay. */
INLINE void expect(const DelayTables *level, int phase, const float *amplitudes, float background,
                   vec *means, vec *slopes)
{
    for (int v = 0; v < level->blocks; v++) {
        means[v] = background * load(level->widths + v * LANES) + LEAST;
        if (slopes)
            slopes[v] = (vec){0};
    }
    for (int i = level->places[phase]; i < level->places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + (size_t)run.place * LANES;
        float a = amplitudes[run.band];
        for (int v = 0; v < run.count; v++) {
            means[run.block + v] += a * load(shares + v * LANES);
            if (slopes)
                slopes[run.block + v] += a * load(shares + (run.count + v) * LANES);
        }
    }
}

/* What is summed over bins: for all bands together, for each one. */
enum { TT, TB, BB, RT, RB, CUBIC, COMMON };
enum { SELF, WIDTH, SLOPE, COUNTS, SUMS };
#define MOST_PAIRS (MOST_BANDS * (MOST_BANDS - 1) / 2)

/* Adds the weighted products of the shares of two bands, of every pair that shares bins. */
INLINE void add_meetings(const DelayTables *level, int phase, const vec *weights, vec *pairs)
{
    for (int i = level->meets[phase]; i < level->meets[phase + 1]; i++) {
        Meeting meeting = level->meetings[i];
        const float *one = level->data + (size_t)meeting.one * LANES;
        const float *other = level->data + (size_t)meeting.other * LANES;
        vec both = {0};
        for (int v = 0; v < meeting.count; v++)
            both += load(one + v * LANES) * weights[meeting.block + v] * load(other + v * LANES);
        pairs[meeting.pair] += both;
    }
}

/* Puts their sums into the lane of the equations; bands that share no bins have none. */
INLINE void put_pairs(const DelayTables *level, int bands, const float *made, Equations *into,
                      int lane)
{
    for (int k = 0; k < bands; k++)
        for (int j = 0; j < k; j++)
            into->normal[AT(k, j)][lane] = 0;
    for (int i = 0; i < level->pairs; i++)
        into->normal[AT(level->pair_bands[2 * i], level->pair_bands[2 * i + 1])][lane] = made[i];
}

/* Sums of one candidate over all bins, into its lane of the equations. `work` has room for five
 * vectors a block. */
INLINE void accumulate(const DelayTables *level, const FitRules *rules, const float *counts,
                       float total, const Candidate *candidate, int bands, int phase, vec *work,
                       Equations *into, int lane)
{
    float amplitudes[MOST_BANDS];
    for (int k = 0; k < bands; k++)
        amplitudes[k] = candidate->amplitudes[k] > 0 ? candidate->amplitudes[k] : 0;
    float least = floor_of(rules, total);
    float background = candidate->background > least ? candidate->background : least;
    vec *weights = work, *along = work + level->blocks, *seen = along + level->blocks;
    vec *flat = seen + level->blocks;
    expect(level, phase, amplitudes, background, weights, along);
    vec tt = {0}, tb = {0}, bb = {0}, rt = {0}, rb = {0}, cubic = {0};
    for (int v = 0; v < level->blocks; v++) {
        vec h = load(counts + v * LANES), width = load(level->widths + v * LANES);
        vec weight = 1.0f / weights[v], slope = along[v], steep = weight * slope;
        weights[v] = weight;
        along[v] = steep;
        seen[v] = weight * h;
        flat[v] = weight * width;
        tt += steep * slope;
        tb += steep * width;
        bb += flat[v] * width;
        rt += steep * h;
        rb += flat[v] * h;
        cubic += steep * steep * slope;
    }
    vec all[COMMON + MOST_BANDS * SUMS + MOST_PAIRS + LANES];
    vec *own = all + COMMON, *pairs = own + bands * SUMS;
    int used = COMMON + bands * SUMS + level->pairs;
    memset(own, 0, sizeof *own * (size_t)(used - COMMON + LANES));
    all[TT] = tt;
    all[TB] = tb;
    all[BB] = bb;
    all[RT] = rt;
    all[RB] = rb;
    all[CUBIC] = cubic;
    for (int i = level->places[phase]; i < level->places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + (size_t)run.place * LANES;
        vec self = {0}, width = {0}, slope = {0}, count = {0};
        for (int v = 0; v < run.count; v++) {
            vec shape = load(shares + v * LANES);
            self += shape * weights[run.block + v] * shape;
            width += shape * flat[run.block + v];
            slope += shape * along[run.block + v];
            count += shape * seen[run.block + v];
        }
        vec *mine = own + run.band * SUMS;
        mine[SELF] += self;
        mine[WIDTH] += width;
        mine[SLOPE] += slope;
        mine[COUNTS] += count;
    }
    add_meetings(level, phase, weights, pairs);
    float made[(COMMON + MOST_BANDS * SUMS + MOST_PAIRS) / LANES * LANES + LANES];
    for (int i = 0; i < used; i += LANES)
        store(made + i, sums(all + i));
    int b = bands, t = bands + 1;
    const float *band_sums = made + COMMON, *pair_sums = band_sums + bands * SUMS;
    for (int k = 0; k < bands; k++, band_sums += SUMS) {
        into->normal[AT(k, k)][lane] = band_sums[SELF];
        into->normal[AT(b, k)][lane] = band_sums[WIDTH];
        into->normal[AT(t, k)][lane] = band_sums[SLOPE];
        into->right[k][lane] = band_sums[COUNTS];
    }
    put_pairs(level, bands, pair_sums, into, lane);
    into->normal[AT(b, b)][lane] = made[BB];
    into->normal[AT(t, b)][lane] = made[TB];
    into->normal[AT(t, t)][lane] = made[TT];
    into->right[b][lane] = made[RB];
    into->right[t][lane] = made[RT];
    into->cubic[lane] = made[CUBIC];
}

/* Solve the systems of all lanes by Cholesky's method. The inverse's lower factor replaces the normal
 * matrix and the solution the right side, both in the parameters' own scale. */
INLINE void solve(Equations *e, int size, float ridge)
{
    vec scale[MOST_SIZE], inverse[MOST_SIZE];
    for (int i = 0; i < size; i++)
        scale[i] = 1.0f / root(e->normal[AT(i, i)]);
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++)
            e->normal[AT(i, j)] *= scale[i] * scale[j];
    for (int j = 0; j < size; j++) {
        vec diagonal = e->normal[AT(j, j)] + ridge;
        for (int k = 0; k < j; k++)
            diagonal -= e->normal[AT(j, k)] * e->normal[AT(j, k)];
        inverse[j] = 1.0f / root(greater(diagonal, fill(0.5f * ridge)));
        for (int i = j + 1; i < size; i++) {
            vec x = e->normal[AT(i, j)];
            for (int k = 0; k < j; k++)
                x -= e->normal[AT(i, k)] * e->normal[AT(j, k)];
            e->normal[AT(i, j)] = x * inverse[j];
        }
    }
    for (int j = 0; j < size; j++) { /* the factor's inverse, column by column from the left */
        vec column[MOST_SIZE];
        column[j] = inverse[j];
        for (int i = j + 1; i < size; i++) {
            vec x = {0};
            for (int k = j; k < i; k++)
                x -= e->normal[AT(i, k)] * column[k];
            column[i] = x * inverse[i];
        }
        for (int i = j; i < size; i++) /* entries right of column j are still the factor's */
            e->normal[AT(i, j)] = column[i];
    }
    vec half[MOST_SIZE];
    for (int i = 0; i < size; i++) {
        half[i] = (vec){0};
        for (int k = 0; k <= i; k++)
            half[i] += e->normal[AT(i, k)] * scale[k] * e->right[k];
    }
    for (int i = 0; i < size; i++) {
        vec x = {0};
        for (int k = i; k < size; k++)
            x += e->normal[AT(k, i)] * half[k];
        e->right[i] = x * scale[i];
    }
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++)
            e->normal[AT(i, j)] *= scale[j];
}

/* One step of scoring for as many candidates as there are lanes, or fewer. `moved` tells of each one
 * whether its delay or an amplitude moved by more than what a settled one may. */
INLINE void step(const ModelTables *tables, const DelayTables *level, const float *counts, size_t stride,
                 const float *totals, const float *offsets, Candidate *const *candidates, int count,
                 vec *work, Equations *e, int *moved)
{
    const FitRules *rules = &tables->rules;
    int bands = tables->bands, size = bands + 2, t = bands + 1;
    float near = rules->settled * rules->settled;
    float alike = rules->settled_amplitude * rules->settled_amplitude;
    float range = rules->high_ns - rules->low_ns, widest = 12 / (range * range);
    float here[LANES];
    for (int lane = 0; lane < LANES; lane++) { /* spare lanes repeat the first candidate */
        const Candidate *candidate = candidates[lane < count ? lane : 0];
        if (lane >= count) {
            for (int i = 0; i < AT(size, 0); i++)
                e->normal[i][lane] = e->normal[i][0];
            for (int i = 0; i < size; i++)
                e->right[i][lane] = e->right[i][0];
            continue;
        }
        int phase = phase_of(level, candidate->delay);
        here[lane] = level->first_ns + (float)phase * level->phase_ns;
        accumulate(level, rules, counts + (size_t)candidate->pixel * stride, totals[candidate->pixel],
                   candidate, bands, phase, work, e, lane);
        float most = 2 * totals[candidate->pixel] + 10, known = 1 / (most * most);
        for (int k = 0; k <= bands; k++)
            e->normal[AT(k, k)][lane] += known;
        e->normal[AT(t, t)][lane] += widest;
    }
    solve(e, size, rules->ridge);
    vec spread[MOST_BANDS];
    for (int k = 0; k < bands; k++) {
        spread[k] = (vec){0};
        for (int i = k; i < size; i++)
            spread[k] += e->normal[AT(i, k)] * e->normal[AT(i, k)];
    }
    for (int lane = 0; lane < count; lane++) {
        Candidate *candidate = candidates[lane];
        float move = e->right[t][lane], limit = rules->spread_ns;
        move = move > limit ? limit : move < -limit ? -limit : move;
        float offset = offsets[candidate->pixel];
        float low = offset + rules->low_ns, high = offset + rules->high_ns;
        float delay = here[lane] + move;
        delay = delay < low ? low : delay > high ? high : delay;
        candidate->background = e->right[bands][lane];
        candidate->cubic = e->cubic[lane];
        float tip = e->normal[AT(t, t)][lane];
        candidate->variance = tip * tip;
        float change = delay - candidate->delay;
        moved[lane] = change * change > near * tip * tip;
        candidate->delay = delay;
        for (int k = 0; k <= bands; k++) /* change of a parameter that follows the delay's */
            candidate->follow[k] = e->normal[AT(t, k)][lane] / tip;
        for (int k = 0; k < bands; k++) {
            change = e->right[k][lane] - candidate->amplitudes[k];
            moved[lane] |= change * change > alike * spread[k][lane];
            candidate->amplitudes[k] = e->right[k][lane];
            candidate->spread[k] = spread[k][lane];
        }
    }
}
