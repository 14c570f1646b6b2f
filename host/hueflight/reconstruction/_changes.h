/* Whether a pixel's counts still are what they were when it was fitted; see changes.py. */

/* Greatest contrast between two histograms in units of its own deviation: of all counts, of each
 * band's zone, and along the derivative by the delay. `now` and `then` are counts at the bins of
 * the search; `work` has room for four vectors a block. */
INLINE float contrast(const Plan *plan, const float *now, const float *then, float scale,
                      float delay, const float *kept_amplitudes, float background, vec *work)
{
    const Coarse *coarse = &plan->coarse;
    const Level *level = &plan->rough;
    float amplitudes[MOST_BANDS], gaps[MOST_BANDS], sizes[MOST_BANDS], most = 0;
    for (int k = 0; k < plan->bands; k++) {
        amplitudes[k] = kept_amplitudes[k] > 0 ? kept_amplitudes[k] : 0;
        gaps[k] = sizes[k] = 0;
    }
    vec gap = {0}, size = {0}, steep_gap = {0}, steep_size = {0};
    vec *apart = work + 2 * level->blocks, *spreads = apart + level->blocks, whole = {0};
    for (int v = 0; v < level->blocks; v++)
        whole += load(then + v * LANES);
    float least = floor_of(&plan->rules, sum(whole));
    expect(level, phase_of(level, delay), amplitudes, background > least ? background : least,
           work, work + level->blocks);
    for (int v = 0; v < level->blocks; v++) {
        vec a = load(now + v * LANES), b = scale * load(then + v * LANES);
        vec steep = work[level->blocks + v] / work[v];
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
