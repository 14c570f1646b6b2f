/* Whether a pixel's counts still are what they were when it was fitted; see changes.py. */

/* Floats of a half of what is remembered of a pixel. */
INLINE size_t memory_room(const Plan *plan) { return (size_t)(plan->rough.bins + 15) / 16 * 16; }

/* Counts of one pixel at the bins of the search. */
INLINE const float *wide_counts(const Plan *plan, const Light *light, size_t pixel,
                                const Scratch *scratch)
{
    Py_ssize_t by = light->bin_step;
    if (light->type == 'H' && (by == 2 || by == -2) && plan->views == 1 && plan->factor == 1
        && plan->coarse.factor == 4) {
        const char *from = light->data + (Py_ssize_t)pixel * light->pixel_step;
        const char *low = by < 0 ? from + (plan->bins - 1) * by : from;
        fours_of_16((const uint16_t *)low, plan->bins, by < 0, scratch->rough);
    } else
        prepare(plan, light, pixel, 0, 0, scratch);
    return scratch->rough;
}

/* Asks for what is remembered of a pixel ahead of its use. */
INLINE void fetch_memory(const float *memory, size_t room)
{
    for (size_t at = 0; at < room; at += 16)
        __builtin_prefetch(memory + at);
}

/* What is remembered of a pixel: its counts, and how the fit's expected counts change with the delay,
 * relative to themselves. */
INLINE void remember(const Plan *plan, const float *counts, float delay, const float *fitted,
                     float background, vec *work, float *memory)
{
    const Level *level = &plan->rough;
    float amplitudes[MOST_BANDS];
    for (int k = 0; k < plan->bands; k++)
        amplitudes[k] = fitted[k] > 0 ? fitted[k] : 0;
    vec whole = {0};
    for (int v = 0; v < level->blocks; v++)
        whole += load(counts + v * LANES);
    float least = floor_of(&plan->rules, sum(whole)), *steep = memory + memory_room(plan);
    expect(level, phase_of(level, delay), amplitudes, background > least ? background : least,
           work, work + level->blocks);
    memset(memory, 0, 2 * memory_room(plan) * sizeof *memory);
    memcpy(memory, counts, (size_t)level->bins * sizeof *counts);
    for (int v = 0; v < level->blocks; v++)
        store(steep + v * LANES, work[level->blocks + v] / work[v]);
}

/* Greatest contrast between counts now and those remembered in units of its own deviation: of all
 * counts, of each band's zone, and along the derivative by the delay. */
INLINE float contrast(const Plan *plan, const float *now, const float *memory, float scale,
                      float delay, vec *apart, vec *spreads)
{
    const Coarse *coarse = &plan->coarse;
    const float *steepness = memory + memory_room(plan);
    float gaps[MOST_BANDS] = {0}, sizes[MOST_BANDS] = {0}, most = 0;
    vec gap = {0}, size = {0}, steep_gap = {0}, steep_size = {0};
    for (int v = 0; v < plan->rough.blocks; v++) {
        vec a = load(now + v * LANES), b = scale * load(memory + v * LANES);
        vec steep = load(steepness + v * LANES);
        apart[v] = a - b;
        spreads[v] = a + scale * b;
        gap += apart[v];
        size += spreads[v];
        steep_gap += steep * apart[v];
        steep_size += steep * steep * spreads[v];
    }
    float lag = rintf((delay - coarse->first_ns) / coarse->step_ns);
    int here = lag < 0 ? 0 : lag > (float)(coarse->lags - 1) ? coarse->lags - 1 : (int)lag;
    for (int run = coarse->places[here]; run < coarse->places[here + 1]; run++) {
        const int16_t *bins = coarse->runs + (size_t)run * 3;
        vec x = {0}, y = {0};
        for (int v = bins[1] / LANES; v * LANES < bins[2]; v++) {
            ivec bin = lane_numbers() + v * LANES, inside = (bin >= bins[1]) & (bin < bins[2]);
            x += choose(inside, apart[v], (vec){0});
            y += choose(inside, spreads[v], (vec){0});
        }
        gaps[bins[0]] += sum(x);
        sizes[bins[0]] += sum(y);
    }
    for (int k = 0; k < plan->bands; k++)
        if (sizes[k] > 0)
            most = fmaxf(most, gaps[k] * gaps[k] / sizes[k]);
    float all = sum(gap), spread = sum(size), along = sum(steep_gap), across = sum(steep_size);
    if (spread > 0)
        most = fmaxf(most, all * all / spread);
    if (across > 0)
        most = fmaxf(most, along * along / across);
    return sqrtf(most);
}
