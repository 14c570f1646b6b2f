/* SPDX-License-Identifier: Apache-2.0 */
/* The joint fit of a tile of pixels: counts at all bin widths, search, scoring, likelihood. */
typedef struct {
    double *delay, *deviation, *other, *amplitudes, *amplitude_std, *background, *detection;
    double *chi_square, *misfit;
    uint8_t *steps;
} Results;

typedef struct {
    float *fine, *wide, *sensor, *earlier, *scores;
    int8_t *tried;
    size_t fine_stride, wide_stride, lags;
    vec *work;
    Equations *equations;
    Candidate *candidates;
} Scratch;

/* Steps of scoring at the fine bins until every candidate has settled. */
INLINE void settle(const ModelTables *tables, const Scratch *scratch, const float *totals,
                   const float *offsets, Candidate **candidates, int count)
{
    const FitRules *rules = &tables->rules;
    Candidate *active[CANDIDATES];
    int moved[LANES];
    if (rules->starts_wide)
        for (int i = 0; i < count; i += LANES)
            step(tables, &tables->wide, scratch->wide, scratch->wide_stride, totals, offsets,
                 candidates + i, count - i < LANES ? count - i : LANES, scratch->work,
                 scratch->equations, moved);
    int left = 0;
    for (int i = 0; i < count; i++)
        if (!rules->starts_wide || sqrtf(candidates[i]->variance) > rules->target_ns)
            active[left++] = candidates[i];
    for (int round = 0; round < rules->steps && left; round++) {
        int kept = 0;
        for (int i = 0; i < left; i += LANES) {
            int some = left - i < LANES ? left - i : LANES;
            step(tables, &tables->fine, scratch->fine, scratch->fine_stride, totals, offsets,
                 active + i, some, scratch->work, scratch->equations, moved);
            for (int lane = 0; lane < some; lane++) {
                Candidate *candidate = active[i + lane];
                candidate->steps++;
                int few = candidate->variance > rules->spread_ns * rules->spread_ns / rules->few_photons;
                if (!rules->settle || moved[lane]
                    || (few && candidate->steps < rules->few_steps))
                    active[kept++] = candidate;
            }
        }
        left = kept;
    }
}

/* Keeps the likelier of a pixel's two candidates, and reports the other if it is nearly as likely. */
INLINE void decide(const ModelTables *tables, const float *counts, float total, Candidate *mine,
                   const Candidate *alternative, vec *work, float *other)
{
    double lead = best_likelihood(tables, counts, total, mine, work)
                - best_likelihood(tables, counts, total, alternative, work);
    if (fabsf(mine->delay - alternative->delay) <= 3 * sqrtf(mine->variance))
        return; /* both found the same maximum */
    int close = fabs(lead) < (double)tables->rules.ambiguous;
    float loser = lead < 0 ? mine->delay : alternative->delay;
    if (lead < 0) {
        int steps = mine->steps;
        *mine = *alternative;
        mine->steps = steps;
    }
    if (close)
        *other = loser;
}

/* Counts of one pixel at all bin widths; returns their sum. */
INLINE float prepare(const ModelTables *tables, const Light *light, size_t pixel, float rate,
                     int place, const Scratch *scratch)
{
    float *fine = scratch->fine + (size_t)place * scratch->fine_stride;
    float *wide = scratch->wide + (size_t)place * scratch->wide_stride;
    float *sensor = tables->factor == 1 ? fine : scratch->sensor;
    read_counts(light, pixel, tables->bins, sensor);
    if (rate > 0)
        coates_correct(sensor, tables->bins, rate, scratch->earlier);
    if (tables->factor > 1)
        group(tables, 1, tables->factor, sensor, fine);
    group(tables, tables->factor, tables->search.factor, fine, wide);
    vec whole = {0};
    for (int block = 0; block < tables->fine.blocks; block++)
        whole += load(fine + block * LANES);
    return sum(whole);
}

INLINE void fit_tile(const ModelTables *tables, const Light *light, const int64_t *which,
                     const float *offsets, const float *rates, size_t first, int count,
                     const AssessmentTables *tests, const Results *results, const Scratch *scratch)
{
    const FitRules *rules = &tables->rules;
    float totals[TILE + BATCH], local[TILE + BATCH], others[TILE], arrivals[TILE];
    Candidate *candidates[CANDIDATES];
    int alternatives[TILE], made = count;
    for (int p = 0; p < count; p++) {
        others[p] = NAN;
        alternatives[p] = -1;
        local[p] = offsets[first + (size_t)p];
        if (p + 2 < count)
            fetch(light, (size_t)which[first + (size_t)p + 2], tables->bins);
        totals[p] = prepare(tables, light, (size_t)which[first + (size_t)p],
                            rates ? rates[first + (size_t)p] : 0, p, scratch);
    }
    for (int p = count; p % BATCH; p++) { /* fill up the last batch */
        local[p] = local[count - 1];
        totals[p] = totals[count - 1];
    }
    for (int p = 0; p < count; p++) {
        const float *wide = scratch->wide + (size_t)p * scratch->wide_stride;
        if (p % BATCH == 0)
            search_lags(tables, wide, scratch->wide_stride, totals + p, local + p, scratch->scores,
                   scratch->tried, scratch->lags);
        const float *scores = scratch->scores + (size_t)(p % BATCH) * scratch->lags;
        const int8_t *tried = scratch->tried + (size_t)(p % BATCH) * scratch->lags;
        int best, second;
        two_best(&tables->search, scores, &best, &second);
        candidates[p] = scratch->candidates + p;
        candidates[p]->pixel = p;
        start(tables, wide, totals[p], scores, tried, best, candidates[p]);
        float worse = second < 0 ? INFINITY : scores[best] - scores[second];
        if (worse < rules->margin + rules->raster * totals[p]) {
            alternatives[p] = made;
            candidates[made] = scratch->candidates + made;
            candidates[made]->pixel = p;
            start(tables, wide, totals[p], scores, tried, second, candidates[made]);
            made++;
        }
    }
    settle(tables, scratch, totals, local, candidates, made);
    for (int p = 0; p < count; p++) {
        const float *fine = scratch->fine + (size_t)p * scratch->fine_stride;
        Candidate *candidate = scratch->candidates + p;
        size_t at = first + (size_t)p;
        if (alternatives[p] >= 0)
            decide(tables, fine, totals[p], candidate, scratch->candidates + alternatives[p], scratch->work,
                   &others[p]);
        float variance = candidate->variance;
        float delay = candidate->delay + 0.25f * variance * variance * candidate->cubic;
        if (rules->posterior && variance > rules->spread_ns * rules->spread_ns / rules->posterior_photons)
            posterior(tables, fine, totals[p], candidate, scratch->work, &delay, &variance);
        float low = local[p] + rules->low_ns, high = local[p] + rules->high_ns;
        delay = delay < low ? low : delay > high ? high : delay;
        variance *= 1 + (float)(tables->bands + 2) / totals[p];
        results->delay[at] = (double)(delay - local[p]);
        results->deviation[at] = (double)sqrtf(variance);
        results->other[at] = (double)(others[p] - local[p]);
        results->background[at] = (double)candidate->background;
        results->steps[at] = (uint8_t)candidate->steps;
        results->detection[at] = (double)NAN;
        if (variance > rules->spread_ns * rules->spread_ns / rules->certain_photons)
            results->detection[at] = (double)likelihood_ratio(
                tables, scratch->wide + (size_t)p * scratch->wide_stride, totals[p], delay, candidate,
                scratch->work);
        for (int k = 0; k < tables->bands; k++) {
            size_t place = at * (size_t)tables->bands + (size_t)k;
            results->amplitudes[place] = (double)candidate->amplitudes[k];
            results->amplitude_std[place] = (double)sqrtf(candidate->spread[k] + 0.5f);
        }
        arrivals[p] = delay;
    }
    assess(tables, tests, scratch->wide, scratch->wide_stride, arrivals, scratch->candidates, count,
           scratch->work, scratch->equations, results->chi_square + first, results->misfit + first);
}

static void fit_pixels(const ModelTables *tables, const Light *light, const int64_t *which,
                       size_t pixels, const float *offsets, const float *rates,
                       const AssessmentTables *tests, const Results *results,
                       const Scratch *scratch)
{
    for (size_t first = 0; first < pixels; first += TILE) {
        size_t left = pixels - first;
        fit_tile(tables, light, which, offsets, rates, first, left < TILE ? (int)left : TILE,
                 tests, results, scratch);
    }
}
