/* SPDX-License-Identifier: Apache-2.0 */
/* Fisher scoring of tracks of one tabulated delay, one in each lane: sums over bins, which read the
 * tables once for all of them, and the normal equations. */

typedef struct {
    vec normal[MOST_SIZE * (MOST_SIZE + 1) / 2]; /* lower triangle, rows one after another */
    vec right[MOST_SIZE];
    vec cubic;
} Equations;

#define AT(row, col) ((row) * ((row) + 1) / 2 + (col))

/* Adds the bins of a segment that `lit_bands` bands light, the same for all calls of one function, so
 * that sums stay in registers. What concerns the background follows from these sums: see `complete`. */
INLINE void add_segment(const ModelTables *tables, const DelayTables *level, const Segment *segment,
                        const vec *counts, const vec *amplitudes, vec background, Equations *e,
                        const int lit_bands)
{
    enum { ROOM = 3 };
    const Lit *lit = level->lit + segment->lit;
    const float *widths = level->widths + segment->bin, *shares[ROOM], *slopes[ROOM];
    int t = tables->bands + 1, bins = segment->bins;
    vec a[ROOM], self[ROOM], along[ROOM], seen[ROOM], pair[ROOM];
    counts += segment->bin;
#pragma GCC unroll 3
    for (int i = 0; i < lit_bands; i++) {
        int k = lit[i].band;
        shares[i] = level->data + lit[i].shares;
        slopes[i] = level->data + lit[i].slopes;
        a[i] = amplitudes[k];
        self[i] = e->normal[AT(k, k)];
        along[i] = e->normal[AT(t, k)];
        seen[i] = e->right[k];
#pragma GCC unroll 3
        for (int j = 0; j < i; j++)
            pair[i + j - 1] = e->normal[AT(k, lit[j].band)];
    }
    vec tt = e->normal[AT(t, t)], rt = e->right[t], cubic = e->cubic;
    for (int v = 0; v < bins; v++) {
        vec h = counts[v], mean = background * widths[v] + LEAST, slope = {0};
#pragma GCC unroll 3
        for (int i = 0; i < lit_bands; i++) {
            mean += a[i] * shares[i][v];
            slope += a[i] * slopes[i][v];
        }
        vec weight = reciprocal(mean), steep = weight * slope, curved = steep * slope;
        tt += curved;
        rt += steep * h;
        cubic += steep * curved;
#pragma GCC unroll 3
        for (int i = 0; i < lit_bands; i++) {
            vec x = weight * shares[i][v];
            self[i] += x * shares[i][v];
            along[i] += x * slope;
            seen[i] += x * h;
#pragma GCC unroll 3
            for (int j = 0; j < i; j++)
                pair[i + j - 1] += x * shares[j][v];
        }
    }
#pragma GCC unroll 3
    for (int i = 0; i < lit_bands; i++) {
        int k = lit[i].band;
        e->normal[AT(k, k)] = self[i];
        e->normal[AT(t, k)] = along[i];
        e->right[k] = seen[i];
#pragma GCC unroll 3
        for (int j = 0; j < i; j++)
            e->normal[AT(k, lit[j].band)] = pair[i + j - 1];
    }
    e->normal[AT(t, t)] = tt;
    e->right[t] = rt;
    e->cubic = cubic;
}

/* The same for any number of bands. */
APART void add_many(const ModelTables *tables, const DelayTables *level, const Segment *segment,
                    const vec *counts, const vec *amplitudes, vec background, Equations *e)
{
    const Lit *lit = level->lit + segment->lit;
    int t = tables->bands + 1;
    for (int v = 0; v < segment->bins; v++) {
        float w = level->widths[segment->bin + v];
        vec h = counts[segment->bin + v], mean = background * w + LEAST, slope = {0};
        for (int i = 0; i < segment->bands; i++) {
            mean += amplitudes[lit[i].band] * level->data[lit[i].shares + v];
            slope += amplitudes[lit[i].band] * level->data[lit[i].slopes + v];
        }
        vec weight = reciprocal(mean), steep = weight * slope;
        e->normal[AT(t, t)] += steep * slope;
        e->right[t] += steep * h;
        e->cubic += steep * steep * slope;
        for (int i = 0; i < segment->bands; i++) {
            int k = lit[i].band;
            float share = level->data[lit[i].shares + v];
            vec x = weight * share;
            e->normal[AT(k, k)] += x * share;
            e->normal[AT(t, k)] += x * slope;
            e->right[k] += x * h;
            for (int j = 0; j < i; j++)
                e->normal[AT(k, lit[j].band)] += x * level->data[lit[j].shares + v];
        }
    }
}

/* Sums that concern the background. The weight is 1 ÷ mean, and the mean is the sum of what the bands
 * and the background contribute: for any q that goes with bins, Σ q = Σ_k a_k Σ s_k q ÷ mean
 * + background · Σ w q ÷ mean. Bins that no band lights need therefore not be looked at. */
INLINE void complete(const ModelTables *tables, const DelayTables *level, int phase,
                     const vec *amplitudes, vec background, vec total, Equations *e)
{
    int bands = tables->bands, b = bands, t = b + 1;
    const float *sums = level->sums + (size_t)phase * 2 * (size_t)bands;
    vec inverse = 1.0f / background, bb = fill(level->whole), rb = total, tb = {0};
    for (int k = 0; k < bands; k++) {
        vec rest = fill(sums[2 * k]);
        for (int j = 0; j < bands; j++)
            rest -= amplitudes[j] * e->normal[j < k ? AT(k, j) : AT(j, k)];
        vec width = rest * inverse;
        e->normal[AT(b, k)] = width;
        bb -= amplitudes[k] * width;
        rb -= amplitudes[k] * e->right[k];
        tb += amplitudes[k] * (sums[2 * k + 1] - e->normal[AT(t, k)]);
    }
    e->normal[AT(b, b)] = bb * inverse;
    e->right[b] = rb * inverse;
    e->normal[AT(t, b)] = tb * inverse;
}

/* One function for each number of bands: a compiler that inlined them would round differently. */
#define ADD(NAME, BANDS)                                                                          \
    APART void NAME(                                                   \
        const ModelTables *tables, const DelayTables *level, const Segment *segment,              \
        const vec *counts, const vec *amplitudes, vec background, Equations *e)                   \
    {                                                                                             \
        add_segment(tables, level, segment, counts, amplitudes, background, e, BANDS);            \
    }
ADD(add_one, 1)
ADD(add_two, 2)
ADD(add_three, 3)

enum { READ_BINS = 32 }; /* bins that are read at once, so that they are used while in the cache */

/* Sums over all bins that a band lights. Counts are read on the way: `counts` has room for all bins;
 * `total` is the sum of them all. */
INLINE void accumulate(const ModelTables *tables, const DelayTables *level, const Source *source,
                       int phase, const vec *amplitudes, vec background, vec total, vec *counts,
                       Equations *e)
{
    memset(e->normal, 0, sizeof(vec) * (size_t)AT(tables->bands + 2, 0));
    memset(e->right, 0, sizeof(vec) * (size_t)(tables->bands + 2));
    e->cubic = (vec){0};
    int ready = 0;
    for (int i = level->segment_places[phase]; i < level->segment_places[phase + 1]; i++) {
        const Segment *segment = level->segments + i;
        if (!segment->bands)
            continue;
        if (ready < segment->bin)
            ready = segment->bin;
        for (int next; ready < segment->bin + segment->bins; ready = next) {
            next = ready + READ_BINS < level->bins ? ready + READ_BINS : level->bins;
            read_side_by_side(source, ready, next, counts);
        }
        switch (segment->bands) {
        case 1: add_one(tables, level, segment, counts, amplitudes, background, e); break;
        case 2: add_two(tables, level, segment, counts, amplitudes, background, e); break;
        case 3: add_three(tables, level, segment, counts, amplitudes, background, e); break;
        default: add_many(tables, level, segment, counts, amplitudes, background, e);
        }
    }
    complete(tables, level, phase, amplitudes, background, total, e);
}

/* Solve the systems of all lanes by Cholesky's method. The inverse's lower factor replaces the normal
 * matrix and the solution the right side, both in the parameters' own scale. */
APART void solve(Equations *e, int size, float ridge)
{
    vec scale[MOST_SIZE], inverse[MOST_SIZE];
    for (int i = 0; i < size; i++)
        scale[i] = reciprocal_root(e->normal[AT(i, i)]);
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++)
            e->normal[AT(i, j)] *= scale[i] * scale[j];
    for (int j = 0; j < size; j++) {
        vec diagonal = e->normal[AT(j, j)] + ridge;
        for (int k = 0; k < j; k++)
            diagonal -= e->normal[AT(j, k)] * e->normal[AT(j, k)];
        inverse[j] = reciprocal_root(greater(diagonal, fill(0.5f * ridge)));
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

/* One step of scoring of tracks that have the same phase, of which `count` are wanted and the others
 * repeat one of them. `again` tells of each one whether it needs a further step: its delay or an
 * amplitude moved by more than what a settled one may, or it has taken too few. */
INLINE void step(const ModelTables *tables, const DelayTables *level, const Source *source, int phase,
                 float *const *tracks, int count, vec *counts, Equations *e, ivec *moved, ivec *few)
{
    const FitRules *rules = &tables->rules;
    int bands = tables->bands, size = bands + 2, t = bands + 1;
    float near = rules->settled * rules->settled;
    float alike = rules->settled_amplitude * rules->settled_amplitude;
    float range = rules->high_ns - rules->low_ns, widest = 12 / (range * range);
    vec now[AT_AMPLITUDES + 3 * MOST_BANDS + 1 + 2 * LANES], amplitudes[MOST_BANDS];
    read_fields((const float *const *)tracks, AT_AMPLITUDES + bands, now);
    vec total = now[AT_TOTAL], least = rules->floor_photons + rules->floor_share * total;
    for (int k = 0; k < bands; k++)
        amplitudes[k] = greater(now[AT_AMPLITUDES + k], (vec){0});
    vec background = greater(now[AT_BACKGROUND], least);
    accumulate(tables, level, source, phase, amplitudes, background, total, counts, e);
    vec most = 2.0f * total + 10.0f, known = 1.0f / (most * most);
    for (int k = 0; k <= bands; k++)
        e->normal[AT(k, k)] += known;
    e->normal[AT(t, t)] += widest;
    solve(e, size, rules->ridge);

    vec limit = fill(rules->spread_ns), low = now[AT_OFFSET] + rules->low_ns;
    vec delay = level->first_ns + (float)phase * level->phase_ns
              + lesser(greater(e->right[t], -limit), limit);
    delay = lesser(greater(delay, low), now[AT_OFFSET] + rules->high_ns);
    vec tip = e->normal[AT(t, t)], change = delay - now[AT_DELAY], variance = tip * tip;
    *moved = change * change > near * variance;
    *few = variance > rules->spread_ns * rules->spread_ns / rules->few_photons;
    now[AT_DELAY] = delay;
    now[AT_BACKGROUND] = e->right[bands];
    now[AT_VARIANCE] = variance;
    now[AT_CUBIC] = e->cubic;
    for (int k = 0; k < bands; k++) {
        vec spread = {0};
        for (int i = k; i < size; i++)
            spread += e->normal[AT(i, k)] * e->normal[AT(i, k)];
        change = e->right[k] - now[AT_AMPLITUDES + k];
        *moved |= change * change > alike * spread;
        now[AT_AMPLITUDES + k] = e->right[k];
        now[spread_place(bands) + k] = spread;
    }
    int fields = follow_place(bands);
    if (any(variance > rules->spread_ns * rules->spread_ns / rules->posterior_photons)) {
        vec inverse = 1.0f / tip;
        for (int k = 0; k <= bands; k++) /* change of a parameter that follows the delay's */
            now[fields + k] = e->normal[AT(t, k)] * inverse;
        fields = track_fields(bands);
    }
    write_fields(now, fields, tracks, count);
}
