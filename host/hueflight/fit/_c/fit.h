/* The joint fit of a tile of pixels: counts at all bin widths, search, scoring, likelihood. */
typedef struct {
    double *delay, *deviation, *other, *amplitudes, *amplitude_std, *background;
    uint8_t *steps;
} Results;

typedef struct {
    float *fine, *rough, *sensor, *earlier, *scores;
    int8_t *tried;
    size_t fine_stride, rough_stride, lags;
    vec *work;
    Equations *equations;
    Track *tracks;
} Scratch;

/* Steps of scoring at the full bin width until every track has settled. */
INLINE void settle(const Plan *plan, const Scratch *scratch, const float *totals,
                   const float *offsets, Track **tracks, int count)
{
    const Rules *rules = &plan->rules;
    Track *active[TRACKS];
    int moved[LANES];
    if (rules->rough)
        for (int i = 0; i < count; i += LANES)
            step(plan, &plan->rough, scratch->rough, scratch->rough_stride, totals, offsets,
                 tracks + i, count - i < LANES ? count - i : LANES, scratch->work, scratch->equations, moved);
    int left = 0;
    for (int i = 0; i < count; i++)
        if (!rules->rough || sqrtf(tracks[i]->variance) > rules->target_ns)
            active[left++] = tracks[i];
    for (int round = 0; round < rules->steps && left; round++) {
        int kept = 0;
        for (int i = 0; i < left; i += LANES) {
            int some = left - i < LANES ? left - i : LANES;
            step(plan, &plan->fine, scratch->fine, scratch->fine_stride, totals, offsets,
                 active + i, some, scratch->work, scratch->equations, moved);
            for (int lane = 0; lane < some; lane++) {
                Track *track = active[i + lane];
                track->steps++;
                int few = track->variance > rules->spread_ns * rules->spread_ns / rules->few;
                if (!rules->settle || moved[lane]
                    || (few && track->steps < rules->few_steps))
                    active[kept++] = track;
            }
        }
        left = kept;
    }
}

/* Between a pixel's two tracks: the likelier is kept, the other told if it is nearly as likely. */
INLINE void decide(const Plan *plan, const float *counts, float total, Track *mine,
                   const Track *rival, vec *work, float *other)
{
    double lead = best_likelihood(plan, counts, total, mine, work)
                - best_likelihood(plan, counts, total, rival, work);
    if (fabsf(mine->delay - rival->delay) <= 3 * sqrtf(mine->variance))
        return; /* both found the same maximum */
    int close = fabs(lead) < (double)plan->rules.ambiguous;
    float loser = lead < 0 ? mine->delay : rival->delay;
    if (lead < 0) {
        int steps = mine->steps;
        *mine = *rival;
        mine->steps = steps;
    }
    if (close)
        *other = loser;
}

/* Counts of one pixel at all bin widths; returns their sum. */
INLINE float prepare(const Plan *plan, const Light *light, size_t pixel, float rate, int place,
                     const Scratch *scratch)
{
    float *fine = scratch->fine + (size_t)place * scratch->fine_stride;
    float *rough = scratch->rough + (size_t)place * scratch->rough_stride;
    float *sensor = plan->factor == 1 ? fine : scratch->sensor;
    read_counts(light, pixel, plan->bins, sensor);
    if (rate > 0)
        unshadow(sensor, plan->bins, rate, scratch->earlier);
    if (plan->factor > 1)
        group(plan, 1, plan->factor, sensor, fine);
    group(plan, plan->factor, plan->coarse.factor, fine, rough);
    vec whole = {0};
    for (int block = 0; block < plan->fine.blocks; block++)
        whole += load(fine + block * LANES);
    return sum(whole);
}

INLINE void fit_tile(const Plan *plan, const Light *light, const int64_t *which,
                     const float *offsets, const float *rates, size_t first, int count,
                     const Results *results, const Scratch *scratch)
{
    const Rules *rules = &plan->rules;
    float totals[TILE + PARTY], local[TILE + PARTY], others[TILE];
    Track *tracks[TRACKS];
    int rivals[TILE], made = count;
    for (int p = 0; p < count; p++) {
        others[p] = NAN;
        rivals[p] = -1;
        local[p] = offsets[first + (size_t)p];
        if (p + 2 < count)
            fetch(light, (size_t)which[first + (size_t)p + 2], plan->bins);
        totals[p] = prepare(plan, light, (size_t)which[first + (size_t)p],
                            rates ? rates[first + (size_t)p] : 0, p, scratch);
    }
    for (int p = count; p % PARTY; p++) { /* to make up the last party */
        local[p] = local[count - 1];
        totals[p] = totals[count - 1];
    }
    for (int p = 0; p < count; p++) {
        const float *rough = scratch->rough + (size_t)p * scratch->rough_stride;
        if (p % PARTY == 0)
            search(plan, rough, scratch->rough_stride, totals + p, local + p, scratch->scores,
                   scratch->tried, scratch->lags);
        const float *scores = scratch->scores + (size_t)(p % PARTY) * scratch->lags;
        const int8_t *tried = scratch->tried + (size_t)(p % PARTY) * scratch->lags;
        int best, second;
        two_best(&plan->coarse, scores, &best, &second);
        tracks[p] = scratch->tracks + p;
        tracks[p]->pixel = p;
        start(plan, rough, totals[p], scores, tried, best, tracks[p]);
        float worse = second < 0 ? INFINITY : scores[best] - scores[second];
        if (worse < rules->margin + rules->raster * totals[p]) {
            rivals[p] = made;
            tracks[made] = scratch->tracks + made;
            tracks[made]->pixel = p;
            start(plan, rough, totals[p], scores, tried, second, tracks[made]);
            made++;
        }
    }
    settle(plan, scratch, totals, local, tracks, made);
    for (int p = 0; p < count; p++) {
        const float *fine = scratch->fine + (size_t)p * scratch->fine_stride;
        Track *track = scratch->tracks + p;
        size_t at = first + (size_t)p;
        if (rivals[p] >= 0)
            decide(plan, fine, totals[p], track, scratch->tracks + rivals[p], scratch->work,
                   &others[p]);
        float variance = track->variance;
        float delay = track->delay + 0.25f * variance * variance * track->cubic;
        if (rules->posterior && variance > rules->spread_ns * rules->spread_ns / rules->fewest)
            posterior(plan, fine, totals[p], track, scratch->work, &delay, &variance);
        float low = local[p] + rules->low_ns, high = local[p] + rules->high_ns;
        delay = delay < low ? low : delay > high ? high : delay;
        variance *= 1 + (float)(plan->bands + 2) / totals[p];
        results->delay[at] = (double)(delay - local[p]);
        results->deviation[at] = (double)sqrtf(variance);
        results->other[at] = (double)(others[p] - local[p]);
        results->background[at] = (double)track->background;
        results->steps[at] = (uint8_t)track->steps;
        for (int k = 0; k < plan->bands; k++) {
            size_t place = at * (size_t)plan->bands + (size_t)k;
            results->amplitudes[place] = (double)track->amplitudes[k];
            results->amplitude_std[place] = (double)sqrtf(track->spread[k] + 0.5f);
        }
    }
}

static void fit_pixels(const Plan *plan, const Light *light, const int64_t *which, size_t pixels,
                       const float *offsets, const float *rates, const Results *results,
                       const Scratch *scratch)
{
    for (size_t first = 0; first < pixels; first += TILE) {
        size_t left = pixels - first;
        fit_tile(plan, light, which, offsets, rates, first, left < TILE ? (int)left : TILE, results,
                 scratch);
    }
}
