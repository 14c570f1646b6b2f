/* SPDX-License-Identifier: Apache-2.0 */
/* Whether a pixel's counts still are what they were when it was fitted; change_detection.py is the
 * definition. */

/* Weights of a pixel's bins. */
INLINE size_t weight_room(const ModelTables *tables)
{
    size_t bins = (size_t)tables->wide.bins, multiple = REFERENCE_MULTIPLE;
    return (bins + multiple - 1) / multiple * multiple;
}

/* Sums of a pixel's counts: with the squares of the weights, with the weights, all, and in each band's
 * zone. The variance of those with the weights is the first one, of all others they themselves. */
enum { ACROSS, ALONG, ALL, ZONES };

INLINE size_t contrast_sums(const ModelTables *tables) { return ZONES + (size_t)tables->bands; }

/* Counts of one pixel at the bins of the search. */
INLINE const float *wide_counts(const ModelTables *tables, const Light *light, size_t pixel,
                                const Scratch *scratch)
{
    Py_ssize_t by = light->bin_step;
    if (light->type == 'H' && (by == 2 || by == -2) && tables->views == 1 && tables->factor == 1
        && tables->search.factor == 4) {
        const char *from = light->data + (Py_ssize_t)pixel * light->pixel_step;
        const char *low = by < 0 ? from + (tables->bins - 1) * by : from;
        fours_of_16((const uint16_t *)low, tables->bins, by < 0, scratch->wide);
    } else {
        prepare(tables, light, pixel, 0, scratch->sensor, scratch->earlier, scratch->fine);
        group(tables, tables->factor, tables->search.factor, scratch->fine, scratch->wide);
    }
    return scratch->wide;
}

typedef int8_t bytes __attribute__((vector_size(LANES), aligned(1)));
typedef int16_t words __attribute__((vector_size(2 * LANES)));

/* Weights as floats; compilers extend whole numbers twofold at a time. */
INLINE vec widen_8(const int8_t *from)
{
    words some = __builtin_convertvector(*(const bytes *)from, words);
    return __builtin_convertvector(__builtin_convertvector(some, ivec), vec);
}

/* Numbers from −127 to 127 as weights, rounded to the nearest. */
INLINE void narrow_8(vec numbers, int8_t *to)
{
    const float big = 12582912.0f; /* 1.5 · 2²³, above which floats are whole */
    ivec whole = __builtin_convertvector((numbers + big) - big, ivec);
    *(bytes *)to = __builtin_convertvector(__builtin_convertvector(whole, words), bytes);
}

/* Sums of counts by which changes are told, the zones those of the lag next to a delay. `work` has room
 * for the blocks and one more. */
INLINE void sum_contrasts(const ModelTables *tables, const float *counts, const int8_t *weights,
                          float delay, vec *work, float *sums)
{
    const SearchTables *search = &tables->search;
    float *before = (float *)work; /* sum of the counts before each bin */
    vec along = {0}, across = {0}, whole = {0};
    ivec lanes = lane_numbers();
    before[0] = 0;
    for (int v = 0; v < tables->wide.blocks; v++) {
        vec a = load(counts + v * LANES), weight = widen_8(weights + v * LANES), part = weight * a;
        along += part;
        across += weight * part;
        for (int by = 1; by < LANES; by *= 2)
            a += choose(lanes >= by, picked(a, (lanes - by) & (LANES - 1)), (vec){0});
        a += whole;
        store(before + 1 + v * LANES, a);
        whole = fill(a[LANES - 1]);
    }
    sums[ALL] = whole[0];
    sums[ALONG] = sum(along);
    sums[ACROSS] = sum(across);
    memset(sums + ZONES, 0, (size_t)tables->bands * sizeof *sums);
    float lag = rintf((delay - search->first_ns) / search->step_ns);
    int here = lag < 0 ? 0 : lag > (float)(search->lags - 1) ? search->lags - 1 : (int)lag;
    for (int run = search->places[here]; run < search->places[here + 1]; run++) {
        const int32_t *bins = search->runs + (size_t)run * 3;
        sums[ZONES + bins[0]] += before[bins[2]] - before[bins[1]];
    }
}

/* Change reference of a pixel: weights of its bins, which follow the derivative of the fit's expected
 * counts by the delay, relative to themselves, and sums of its counts. */
INLINE void change_reference(const ModelTables *tables, const float *counts, float delay,
                             const float *fitted, float background, vec *work, int8_t *weights,
                             float *sums)
{
    const DelayTables *level = &tables->wide;
    float amplitudes[MOST_BANDS], steepest = 0;
    for (int k = 0; k < tables->bands; k++)
        amplitudes[k] = fitted[k] > 0 ? fitted[k] : 0;
    vec whole = {0}, most = {0}, *steep = work + level->blocks;
    for (int v = 0; v < level->blocks; v++)
        whole += load(counts + v * LANES);
    float least = floor_of(&tables->rules, sum(whole));
    expect(level, phase_of(level, delay), amplitudes, background > least ? background : least,
           work, steep);
    for (int v = 0; v < level->blocks; v++) {
        ivec inside = lane_numbers() + v * LANES < level->bins;
        steep[v] = choose(inside, steep[v] / work[v], (vec){0});
        most = greater(most, (vec)((ivec)steep[v] & 0x7fffffff));
    }
    for (int lane = 0; lane < LANES; lane++)
        steepest = most[lane] > steepest ? most[lane] : steepest;
    memset(weights, 0, weight_room(tables));
    for (int v = 0; v < level->blocks; v++)
        narrow_8(steep[v] * (steepest > 0 ? MOST_WEIGHT / steepest : 0), weights + v * LANES);
    sum_contrasts(tables, counts, weights, delay, work, sums);
}

/* Greatest difference between counts now and at the last fit, in units of its standard deviation. */
INLINE float change_significance(const ModelTables *tables, const float *counts,
                                 const int8_t *weights, const float *kept, float scale, float delay,
                                 vec *work)
{
    enum { MOST_SUMS = ZONES + MOST_BANDS + LANES };
    float now[MOST_SUMS] = {0}, then[MOST_SUMS] = {0}, most = 0;
    size_t made = contrast_sums(tables);
    memcpy(then, kept, made * sizeof *then);
    sum_contrasts(tables, counts, weights, delay, work, now);
    vec greatest = {0}, zero = {0};
    for (size_t at = ALONG; at < made; at += LANES) {
        vec seen = load(now + at), earlier = load(then + at), gap = seen - scale * earlier;
        if (at == ALONG) {
            seen[0] = now[ACROSS];
            earlier[0] = then[ACROSS];
        }
        vec size = seen + scale * scale * earlier, ratio = gap * gap / (size + LEAST);
        greatest = greater(greatest, choose(size > zero, ratio, zero));
    }
    for (int lane = 0; lane < LANES; lane++)
        most = greatest[lane] > most ? greatest[lane] : most;
    return sqrtf(most);
}
