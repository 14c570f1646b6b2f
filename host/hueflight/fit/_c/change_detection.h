/* SPDX-License-Identifier: Apache-2.0 */
/* Whether a pixel's counts still are what they were when it was fitted; change_detection.py is the
 * definition. */

/* Floats in each half of a pixel's change reference. */
INLINE size_t reference_size(const ModelTables *tables)
{
    size_t bins = (size_t)tables->wide.bins, multiple = REFERENCE_MULTIPLE;
    return (bins + multiple - 1) / multiple * multiple;
}

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

/* Prefetches a pixel's change reference. */
INLINE void fetch_reference(const float *memory, size_t room)
{
    for (size_t at = 0; at < room; at += 16)
        __builtin_prefetch(memory + at);
}

/* Change reference of a pixel: its counts, and the derivative of the fit's expected counts by the
 * delay, relative to themselves. */
INLINE void change_reference(const ModelTables *tables, const float *counts, float delay,
                             const float *fitted, float background, vec *work, float *memory)
{
    const DelayTables *level = &tables->wide;
    float amplitudes[MOST_BANDS];
    for (int k = 0; k < tables->bands; k++)
        amplitudes[k] = fitted[k] > 0 ? fitted[k] : 0;
    vec whole = {0};
    for (int v = 0; v < level->blocks; v++)
        whole += load(counts + v * LANES);
    float least = floor_of(&tables->rules, sum(whole)), *steep = memory + reference_size(tables);
    expect(level, phase_of(level, delay), amplitudes, background > least ? background : least,
           work, work + level->blocks);
    memset(memory, 0, 2 * reference_size(tables) * sizeof *memory);
    memcpy(memory, counts, (size_t)level->bins * sizeof *counts);
    for (int v = 0; v < level->blocks; v++)
        store(steep + v * LANES, work[level->blocks + v] / work[v]);
}

/* Greatest difference between counts now and at the last fit, in units of its standard deviation: of
 * all counts, of each band's zone, and along the derivative by the delay. */
INLINE float change_significance(const ModelTables *tables, const float *now, const float *memory,
                                 float scale, float delay, vec *apart, vec *spreads)
{
    const SearchTables *search = &tables->search;
    const float *steepness = memory + reference_size(tables);
    float gaps[MOST_BANDS] = {0}, sizes[MOST_BANDS] = {0}, most = 0;
    vec gap = {0}, size = {0}, steep_gap = {0}, steep_size = {0};
    for (int v = 0; v < tables->wide.blocks; v++) {
        vec a = load(now + v * LANES), b = scale * load(memory + v * LANES);
        vec steep = load(steepness + v * LANES);
        apart[v] = a - b;
        spreads[v] = a + scale * b;
        gap += apart[v];
        size += spreads[v];
        steep_gap += steep * apart[v];
        steep_size += steep * steep * spreads[v];
    }
    float lag = rintf((delay - search->first_ns) / search->step_ns);
    int here = lag < 0 ? 0 : lag > (float)(search->lags - 1) ? search->lags - 1 : (int)lag;
    for (int run = search->places[here]; run < search->places[here + 1]; run++) {
        const int32_t *bins = search->runs + (size_t)run * 3;
        vec x = {0}, y = {0};
        for (int v = bins[1] / LANES; v * LANES < bins[2]; v++) {
            ivec bin = lane_numbers() + v * LANES, inside = (bin >= bins[1]) & (bin < bins[2]);
            x += choose(inside, apart[v], (vec){0});
            y += choose(inside, spreads[v], (vec){0});
        }
        gaps[bins[0]] += sum(x);
        sizes[bins[0]] += sum(y);
    }
    for (int k = 0; k < tables->bands; k++)
        if (sizes[k] > 0)
            most = fmaxf(most, gaps[k] * gaps[k] / sizes[k]);
    float all = sum(gap), spread = sum(size), along = sum(steep_gap), across = sum(steep_size);
    if (spread > 0)
        most = fmaxf(most, all * all / spread);
    if (across > 0)
        most = fmaxf(most, along * along / across);
    return sqrtf(most);
}
