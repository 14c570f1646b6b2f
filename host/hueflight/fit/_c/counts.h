/* SPDX-License-Identifier: Apache-2.0 */
/* Counts in memory: reading, summing, and the correction of pile-up. */

/* Where counts lie, and of which type: 'H', 'I' or 'f'. */
typedef struct {
    const char *data;
    Py_ssize_t pixels, pixel_step, bin_step;
    char type;
} Light;

INLINE const char *row_of(const Light *light, size_t pixel)
{
    return light->data + (Py_ssize_t)pixel * light->pixel_step;
}

/* Whether bins lie next to one another. */
INLINE int is_dense(const Light *light)
{
    Py_ssize_t size = light->type == 'H' ? 2 : 4;
    return light->bin_step == size || light->bin_step == -size;
}

/* 16 bits each to floats, whole vectors of them as far as they go. */
INLINE void widen(const uint16_t *from, int count, float *to)
{
    typedef uint16_t some __attribute__((vector_size(2 * LANES), aligned(2)));
    int i = 0;
    for (; i + LANES <= count; i += LANES)
        store(to + i, __builtin_convertvector(*(const some *)(from + i), vec));
    for (; i < count; i++)
        to[i] = (float)from[i];
}

/* The last of `from` first, as floats. */
#define BACKWARDS(NAME, TYPE)                                                                     \
    INLINE void NAME(const TYPE *from, int count, float *to)                                      \
    {                                                                                             \
        typedef TYPE some __attribute__((vector_size(sizeof(TYPE) * LANES), aligned(2)));         \
        ivec turned = LANES - 1 - lane_numbers();                                                 \
        int i = 0;                                                                                \
        for (; i + LANES <= count; i += LANES)                                                    \
            store(to + count - LANES - i,                                                         \
                  picked(__builtin_convertvector(*(const some *)(from + i), vec), turned));       \
        for (; i < count; i++)                                                                    \
            to[count - 1 - i] = (float)from[i];                                                   \
    }
BACKWARDS(backwards_16, uint16_t)
BACKWARDS(backwards_32, uint32_t)

/* Counts of one pixel as floats, from its first bin on. Memory is read upwards, whichever way time
 * runs: processors fetch ahead that way only. */
INLINE void read_row(const Light *light, const char *from, int bins, float *to)
{
    Py_ssize_t by = light->bin_step;
    const char *low = by < 0 ? from + (bins - 1) * by : from;
    if (light->type == 'H' && by == 2)
        widen((const uint16_t *)low, bins, to);
    else if (light->type == 'H' && by == -2)
        backwards_16((const uint16_t *)low, bins, to);
    else if (light->type == 'H')
        for (int i = 0; i < bins; i++)
            to[i] = (float)*(const uint16_t *)(from + i * by);
    else if (light->type == 'I' && by == 4)
        for (int i = 0; i < bins; i++)
            to[i] = (float)((const uint32_t *)low)[i];
    else if (light->type == 'I' && by == -4)
        backwards_32((const uint32_t *)low, bins, to);
    else if (light->type == 'I')
        for (int i = 0; i < bins; i++)
            to[i] = (float)*(const uint32_t *)(from + i * by);
    else if (by == 4)
        memcpy(to, from, (size_t)bins * sizeof *to);
    else
        for (int i = 0; i < bins; i++)
            to[i] = *(const float *)(from + i * by);
}

/* Prefetches a pixel's counts, into the second cache: rows of all lanes would fill the first. */
INLINE void fetch_row(const Light *light, const char *from, int bins)
{
    Py_ssize_t span = (bins - 1) * light->bin_step;
    const char *low = span < 0 ? from + span : from;
    for (Py_ssize_t at = 0; at <= (span < 0 ? -span : span); at += 64)
        __builtin_prefetch(low + at, 0, 2);
}

/* Sums of four bins each, whole vectors of them; returns how many. */
INLINE int fours(const float *from, int count, float *to)
{
    ivec lanes = lane_numbers(), order = lanes / (LANES / 4) + 4 * (lanes % (LANES / 4));
    int j = 0;
    for (; j + LANES <= count; j += LANES) {
        vec mixed = {0}; /* every fourth lane of each of four vectors, side by side */
        for (int i = 0; i < 4; i++) {
            vec x = load(from + 4 * j + i * LANES);
            x += swap(x, 1);
            x += swap(x, 2);
            mixed = choose((lanes & 3) == i, x, mixed);
        }
        store(to + j, picked(mixed, order));
    }
    return j;
}

/* The same for all of a pixel's bins, from 16-bit counts in memory, `backwards` from the last one; the
 * last sum may be of fewer than four. */
INLINE void fours_of_16(const uint16_t *low, int bins, int backwards, float *to)
{
    typedef uint64_t groups __attribute__((vector_size(4 * LANES), aligned(2)));
    typedef float half __attribute__((vector_size(2 * LANES), aligned(4)));
    enum { HALF = LANES / 2 };
    int full = bins / 4, rest = bins % 4, i = 0;
    const uint16_t *from = backwards ? low + rest : low, *left = backwards ? low : low + 4 * full;
    uint64_t even = 0x0000ffff0000ffff;
    vec_64 turned = {0};
    for (int lane = 0; lane < HALF; lane++)
        turned[lane] = backwards ? HALF - 1 - lane : lane;
    for (; i + HALF <= full; i += HALF) {
        groups four = *(const groups *)(from + 4 * i);
        four = (four & even) + (four >> 16 & even);
        vec_64 sums = (vec_64)((four + (four >> 32)) & 0xffffffff);
        float *place = backwards ? to + full - HALF - i : to + i;
        *(half *)place = __builtin_convertvector(picked_64(sums, turned), half);
    }
    for (; i < full; i++)
        to[backwards ? full - 1 - i : i] =
            (float)(from[4 * i] + from[4 * i + 1] + from[4 * i + 2] + from[4 * i + 3]);
    if (rest)
        to[full] = 0;
    for (i = 0; i < rest; i++)
        to[full] += left[i];
}

/* Sums of `factor` bins each within every view; returns how many. `sizes` may be those of the
 * sensor or, with `before`, of bins that were summed already. */
INLINE int group(const ModelTables *tables, int before, int factor, const float *from, float *to)
{
    int made = 0;
    for (int v = 0; v < tables->views; v++) {
        int size = (tables->sizes[v] + before - 1) / before, full = size / factor;
        if (factor == 1)
            memcpy(to + made, from, (size_t)size * sizeof *to);
        else if (factor == 4)
            for (int j = fours(from, full, to + made); j < full; j++)
                to[made + j] = (from[4 * j] + from[4 * j + 1]) + (from[4 * j + 2] + from[4 * j + 3]);
        else
            for (int j = 0; j < full; j++) {
                float x = 0;
                for (int i = 0; i < factor; i++)
                    x += from[j * factor + i];
                to[made + j] = x;
            }
        if (full * factor < size) {
            float rest = 0;
            for (int i = full * factor; i < size; i++)
                rest += from[i];
            to[made + full] = rest;
        }
        made += (size + factor - 1) / factor;
        from += size;
    }
    return made;
}

/* Sums of counts next to one another, of all and of those before bin `first` and from bin `last` on,
 * in a type that holds them; tells whether a counter is at the end of its own type. */
#define SUM_DENSE(NAME, TYPE, SUM, MOST)                                                          \
    INLINE int NAME(const TYPE *counts, int bins, int first, int last, double *all,               \
                    double *outside)                                                              \
    {                                                                                             \
        SUM sum = 0, apart = 0;                                                                   \
        TYPE most = 0;                                                                            \
        for (int i = 0; i < bins; i++) {                                                          \
            sum += counts[i];                                                                     \
            most = counts[i] > most ? counts[i] : most;                                           \
        }                                                                                         \
        for (int i = 0; i < first; i++)                                                           \
            apart += counts[i];                                                                   \
        for (int i = last; i < bins; i++)                                                         \
            apart += counts[i];                                                                   \
        *all = (double)sum;                                                                       \
        *outside = (double)apart;                                                                 \
        return most == MOST;                                                                      \
    }
SUM_DENSE(sum_dense_16, uint16_t, uint32_t, UINT16_MAX) /* of at most 2¹⁶ bins */
SUM_DENSE(sum_dense_32, uint32_t, uint64_t, UINT32_MAX)

/* Sums of one pixel's counts, of all and of those from `low` up to `high`; `full` tells whether a
 * counter is at the end of its type. */
INLINE void sum_counts(const Light *light, size_t pixel, int bins, int low, int high, double *all,
                       double *lit, uint8_t *full)
{
    const char *from = row_of(light, pixel);
    Py_ssize_t by = light->bin_step;
    *full = 0;
    if (is_dense(light) && light->type != 'f') {
        const char *lowest = by > 0 ? from : from + (bins - 1) * by;
        int first = by > 0 ? low : bins - high, last = by > 0 ? high : bins - low;
        double outside;
        *full = (uint8_t)(light->type == 'H'
                              ? sum_dense_16((const uint16_t *)lowest, bins, first, last, all, &outside)
                              : sum_dense_32((const uint32_t *)lowest, bins, first, last, all, &outside));
        *lit = *all - outside;
        return;
    }
    double whole = 0, inside = 0;
    for (int i = 0; i < bins; i++, from += by) {
        double count;
        if (light->type == 'H') {
            count = *(const uint16_t *)from;
            *full |= *(const uint16_t *)from == UINT16_MAX;
        } else if (light->type == 'I') {
            count = *(const uint32_t *)from;
            *full |= *(const uint32_t *)from == UINT32_MAX;
        } else
            count = (double)*(const float *)from;
        whole += count;
        inside += i >= low && i < high ? count : 0;
    }
    *all = whole;
    *lit = inside;
}

/* e^x of numbers from 0 to 80, to 2 units in the last place. */
INLINE vec exponential(vec x)
{
    ivec n = __builtin_convertvector(x * 1.44269504f + 0.5f, ivec);
    vec whole = __builtin_convertvector(n, vec);
    vec r = x - whole * 0.693359375f + whole * 2.12194440e-4f;
    vec series = 0.041666666f + r * (0.0083333333f + r * (0.0013888889f + r * 0.00019841270f));
    series = 1.0f + r * (1.0f + r * (0.5f + r * (0.16666667f + r * series)));
    return series * (vec)((n + 127) << 23);
}

/* Corrects counts for photons that were lost to an earlier one of their period (Coates, 1968); see
 * coates_correction in pileup.py. Both arrays have room for whole vectors. */
INLINE void coates_correct(float *counts, int bins, float rate, float *earlier)
{
    int blocks = (bins + LANES - 1) / LANES;
    ivec lanes = lane_numbers();
    vec before = {0};
    for (int v = 0; v < blocks; v++) {
        vec h = load(counts + v * LANES), sofar = h;
        for (int by = 1; by < LANES; by *= 2)
            sofar += choose(lanes >= by, picked(sofar, (lanes - by) & (LANES - 1)),
                            (vec){0});
        store(earlier + v * LANES, before + sofar - 0.5f * h);
        before += fill(sofar[LANES - 1]);
    }
    float empty = 1.0f / exponential(fill(rate < 80.0f ? rate : 80.0f))[0]; /* share of periods */
    float total = before[0], scale = (1.0f - empty) / (total > 1e-30f ? total : 1e-30f);
    vec whole = {0};
    for (int v = 0; v < blocks; v++) {
        vec later = total - load(earlier + v * LANES);
        vec h = load(counts + v * LANES) / (empty + later * scale);
        store(counts + v * LANES, h);
        whole += h;
    }
    float all = sum(whole);
    scale = total / (all > 1e-30f ? all : 1e-30f);
    for (int v = 0; v < blocks; v++)
        store(counts + v * LANES, load(counts + v * LANES) * scale);
}

/* Whether fine counts must be computed and kept, because memory does not hold them as they are. */
INLINE int kept_apart(const ModelTables *tables, const Light *light, int corrected)
{
    return corrected || tables->factor > 1 || !is_dense(light);
}

/* Counts of one pixel at the fine bins. `sensor` and `earlier` have room for all of the sensor's. */
INLINE void prepare(const ModelTables *tables, const Light *light, size_t pixel, float rate,
                    float *sensor, float *earlier, float *fine)
{
    float *to = tables->factor == 1 ? fine : sensor;
    read_row(light, light->data + (Py_ssize_t)pixel * light->pixel_step, tables->bins, to);
    if (rate > 0)
        coates_correct(to, tables->bins, rate, earlier);
    if (tables->factor > 1)
        group(tables, 1, tables->factor, sensor, fine);
}
