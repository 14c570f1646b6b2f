/* SPDX-License-Identifier: Apache-2.0 */
/* The joint fit of some thousand pixels: search in the order of memory, then scoring and tests of
 * pixels sorted by their delay, so that those side by side share what is read of the tables. What a
 * pixel gives does not depend on those beside it. */
typedef struct {
    double *delay, *deviation, *other, *amplitudes, *amplitude_std, *background, *detection;
    double *chi_square, *misfit;
    uint8_t *steps;
} Results;

/* Pixels that are sorted together: no more than fill most lanes, so that their counts stay in the
 * cache. */
#ifndef LEAST_CHUNK
#define LEAST_CHUNK 512
#endif
enum { CHUNK = 4096 };
#define FILLED_LITTLE 0.8f
#define FILLED_WELL 0.95f

/* Memory for CHUNK pixels, each of which has a track or two; see kernels.c. */
typedef struct {
    float *fine, *wide, *sensor, *earlier; /* counts of pixels, and of one pixel */
    size_t fine_stride, wide_stride;
    vec *counts, *sums, *scores, *shares, *work;
    Equations *equations;
    float *tracks;
    int32_t *pixel, *phase, *active, *sorted, *places; /* of tracks; places of phases */
    uint8_t *steps;
    int32_t *second; /* second track of each pixel, or −1 */
    const char **rows;
    float *offsets, *arrivals, *others;
    uint8_t *tested;
    float *curves; /* of one phase */
} Scratch;

/* Pixels that are fitted together. */
typedef struct {
    const ModelTables *tables;
    const AssessmentTables *tests;
    const Scratch *scratch;
    int count;
    Light fine, wide;  /* counts at both bin widths; rows of `scratch` tell where */
    int taken, groups; /* steps of tracks, and vectors that they filled */
} Chunk;

INLINE float *track_of(const Chunk *chunk, int track)
{
    return chunk->scratch->tracks + (size_t)track * track_room(chunk->tables->bands);
}

/* Counts of one pixel at the fine bins. */
INLINE const float *fine_counts(const Chunk *chunk, int p)
{
    const char *row = chunk->scratch->rows[p];
    if (chunk->fine.type == 'f' && chunk->fine.bin_step == (Py_ssize_t)sizeof(float))
        return (const float *)row;
    read_row(&chunk->fine, row, chunk->tables->fine.bins, chunk->scratch->sensor);
    return chunk->scratch->sensor;
}

/* Finds out where the fine counts of all pixels are. They are computed and kept where they are not in
 * memory as such: after the correction of pile-up, of summed bins, and of bins that lie apart. */
INLINE void locate(Chunk *chunk, const Light *light, const int64_t *which, const float *rates)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    size_t stride = scratch->fine_stride;
    Py_ssize_t size = sizeof(float);
    chunk->wide = (Light){(char *)scratch->wide, CHUNK, (Py_ssize_t)scratch->wide_stride * size, size, 'f'};
    chunk->fine = *light;
    if (!kept_apart(tables, light, rates != NULL)) {
        for (int p = 0; p < chunk->count; p++)
            scratch->rows[p] = row_of(light, (size_t)which[p]);
        return;
    }
    chunk->fine = (Light){(char *)scratch->fine, CHUNK, (Py_ssize_t)stride * size, size, 'f'};
    for (int p = 0; p < chunk->count; p++) {
        if (p + 2 < chunk->count)
            fetch_row(light, row_of(light, (size_t)which[p + 2]), tables->bins);
        float *row = scratch->fine + (size_t)p * stride;
        prepare(tables, light, (size_t)which[p], rates ? rates[p] : 0, scratch->sensor,
                scratch->earlier, row);
        scratch->rows[p] = (const char *)row;
    }
}

/* Searches TOGETHER groups of pixels from the first on; returns how many tracks there are now. */
APART int search_groups(const Chunk *chunk, int first, int made)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    int bands = tables->bands, bins = tables->fine.bins, wide_bins = tables->wide.bins;
    vec totals[TOGETHER], offsets[TOGETHER], fields[AT_AMPLITUDES + MOST_BANDS + LANES];
    for (int g = 0; g < TOGETHER; g++) {
        Source source = {.light = &chunk->fine};
        float offset[LANES];
        for (int lane = 0; lane < LANES; lane++) { /* spare lanes repeat the last pixel */
            int p = first + g * LANES + lane, last = chunk->count - 1;
            source.rows[lane] = scratch->rows[p < last ? p : last];
            offset[lane] = scratch->offsets[p < last ? p : last];
        }
        totals[g] = sum_abreast(tables, &source, scratch->counts, scratch->sums, g);
        offsets[g] = load(offset);
    }
    int done = first + TOGETHER * LANES, left = chunk->count - done;
    Upcoming next = {&chunk->fine, scratch->rows + done,
                     left < 0 ? 0 : left < TOGETHER * LANES ? left : TOGETHER * LANES, bins};
    search_lags(tables, scratch->sums, totals, offsets, &next, scratch->scores, scratch->shares);
    for (int g = 0; g < TOGETHER && first + g * LANES < chunk->count; g++) {
        int begin = first + g * LANES, left = chunk->count - begin, some = left < LANES ? left : LANES;
        const vec *wide = scratch->sums + g, *scores = scratch->scores + g;
        Found found = two_best(&tables->search, scores);
        float *rows[LANES], *kept[LANES];
        for (int lane = 0; lane < some; lane++) {
            rows[lane] = track_of(chunk, begin + lane);
            kept[lane] = scratch->wide + (size_t)(begin + lane) * scratch->wide_stride;
        }
        for (int at = 0; at < wide_bins; at += LANES) {
            vec block[LANES];
            float *to[LANES];
            for (int i = 0; i < LANES; i++)
                block[i] = at + i < wide_bins ? wide[(at + i) * TOGETHER] : (vec){0};
            for (int lane = 0; lane < some; lane++)
                to[lane] = kept[lane] + at;
            write_fields(block, LANES, to, some);
        }
        for (int again = 0; again < 2; again++) {
            ivec limit = found.worse < tables->rules.margin + tables->rules.raster * totals[g];
            ivec lags = again ? (limit & found.second) | ~limit : found.best;
            int32_t lag_of[LANES];
            memcpy(lag_of, &lags, sizeof lag_of);
            float unwanted[AT_AMPLITUDES + MOST_BANDS + LANES];
            int wanted = 0;
            for (int lane = 0; lane < some; lane++) {
                int track = begin + lane;
                if (!again)
                    scratch->second[track] = -1;
                else if (lag_of[lane] >= 0)
                    scratch->second[begin + lane] = track = made++;
                rows[lane] = lag_of[lane] < 0 ? unwanted : track_of(chunk, track);
                wanted |= lag_of[lane] >= 0;
                scratch->pixel[track] = begin + lane;
                scratch->steps[track] = 0;
            }
            if (!wanted)
                continue;
            start(tables, wide, totals[g], scores, scratch->shares + g, lags, fields);
            fields[AT_VARIANCE] = fields[AT_CUBIC] = (vec){0};
            fields[AT_TOTAL] = totals[g];
            fields[AT_OFFSET] = offsets[g];
            write_fields(fields, AT_AMPLITUDES + bands, rows, some);
        }
    }
    return made;
}

/* Prefetches the rows of tracks, at most a vector of them. */
INLINE void fetch_tracks(const Chunk *chunk, const int32_t *tracks, int left)
{
    const Scratch *scratch = chunk->scratch;
    for (int i = 0; i < left && i < LANES; i++)
        fetch_row(&chunk->fine, scratch->rows[scratch->pixel[tracks[i]]], chunk->tables->fine.bins);
}

/* One step of all active tracks at one bin width; returns how many stay active. */
APART int step_all(Chunk *chunk, int count, int wide)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    const FitRules *rules = &tables->rules;
    const DelayTables *level = wide ? &tables->wide : &tables->fine;
    const int32_t *sorted = scratch->sorted;
    Source source = {.light = wide ? &chunk->wide : &chunk->fine};
    int kept = 0, some;
    for (int i = 0; i < count; i++) {
        int track = scratch->active[i];
        scratch->phase[track] = phase_of(level, track_of(chunk, track)[AT_DELAY]);
    }
    sort_by_phase(scratch->phase, level->phases, scratch->active, count, scratch->places,
                  scratch->sorted);
    for (int i = 0; i < count; i += some) {
        float *rows[LANES];
        some = same_phase(scratch->phase, sorted + i, count - i);
        chunk->taken += some;
        chunk->groups++;
        for (int lane = 0; lane < LANES; lane++) { /* spare lanes repeat the first track */
            int track = sorted[i + (lane < some ? lane : 0)], p = scratch->pixel[track];
            rows[lane] = track_of(chunk, track);
            source.rows[lane] = wide ? (const char *)(scratch->wide + (size_t)p * scratch->wide_stride)
                                     : scratch->rows[p];
        }
        if (!wide)
            fetch_tracks(chunk, sorted + i + some, count - i - some);
        ivec moved, few;
        step(tables, level, &source, scratch->phase[sorted[i]], rows, some, scratch->counts,
             scratch->equations, &moved, &few);
        int32_t has_moved[LANES], has_few[LANES];
        memcpy(has_moved, &moved, sizeof has_moved);
        memcpy(has_few, &few, sizeof has_few);
        for (int lane = 0; lane < some; lane++) {
            int track = sorted[i + lane], again;
            if (wide)
                again = sqrtf(rows[lane][AT_VARIANCE]) > rules->target_ns;
            else {
                scratch->steps[track]++;
                again = !rules->settle || has_moved[lane]
                     || (has_few[lane] && scratch->steps[track] < rules->few_steps);
            }
            if (again)
                scratch->active[kept++] = track;
        }
    }
    return kept;
}

/* Keeps the likelier of a pixel's two tracks, and reports the other if it is nearly as likely. */
APART void decide(const Chunk *chunk, int p)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    float *mine = track_of(chunk, p), total = mine[AT_TOTAL];
    const float *other = track_of(chunk, scratch->second[p]), *counts = fine_counts(chunk, p);
    double lead = best_likelihood(tables, counts, total, mine, scratch->work)
                - best_likelihood(tables, counts, total, other, scratch->work);
    if (fabsf(mine[AT_DELAY] - other[AT_DELAY]) <= 3 * sqrtf(mine[AT_VARIANCE]))
        return; /* both found the same maximum */
    if (fabs(lead) < (double)tables->rules.ambiguous)
        scratch->others[p] = lead < 0 ? mine[AT_DELAY] : other[AT_DELAY];
    if (lead < 0)
        memcpy(mine, other, track_room(tables->bands) * sizeof *mine);
}

/* Results of one pixel but for those of its tests. */
APART void conclude(const Chunk *chunk, int p, const Results *results, size_t at)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    const FitRules *rules = &tables->rules;
    int bands = tables->bands;
    const float *track = track_of(chunk, p);
    float variance = track[AT_VARIANCE], offset = track[AT_OFFSET], total = track[AT_TOTAL];
    float delay = track[AT_DELAY] + 0.25f * variance * variance * track[AT_CUBIC];
    float unit = rules->spread_ns * rules->spread_ns;
    if (rules->posterior && variance > unit / rules->posterior_photons)
        posterior(tables, fine_counts(chunk, p), total, track, scratch->work, &delay, &variance);
    float low = offset + rules->low_ns, high = offset + rules->high_ns;
    delay = delay < low ? low : delay > high ? high : delay;
    variance *= 1 + (float)(bands + 2) / total;
    scratch->arrivals[p] = delay;
    scratch->tested[p] = variance > unit / rules->certain_photons;
    results->delay[at] = (double)(delay - offset);
    results->deviation[at] = (double)sqrtf(variance);
    results->other[at] = (double)(scratch->others[p] - offset);
    results->background[at] = (double)track[AT_BACKGROUND];
    results->steps[at] = scratch->steps[p];
    double *amplitudes = results->amplitudes + at * (size_t)bands;
    double *deviations = results->amplitude_std + at * (size_t)bands;
    for (int k = 0; k < bands; k++) {
        amplitudes[k] = (double)track[AT_AMPLITUDES + k];
        deviations[k] = (double)sqrtf(track[spread_place(bands) + k] + 0.5f);
    }
}

/* Tests of pixels that have the same delay, `count` of which are wanted. */
APART void test_group(const Chunk *chunk, const int32_t *pixels, int count, double *detection,
                       double *chi_square, double *misfit)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    int bands = tables->bands, bins = tables->wide.bins, phase = scratch->phase[pixels[0]], tested = 0;
    Source source = {.light = &chunk->wide};
    const float *rows[LANES];
    for (int lane = 0; lane < LANES; lane++) {
        int p = pixels[lane < count ? lane : 0];
        source.rows[lane] = (const char *)(scratch->wide + (size_t)p * scratch->wide_stride);
        rows[lane] = track_of(chunk, p);
        tested |= scratch->tested[p];
    }
    vec *counts = scratch->counts, chi = fill(NAN);
    vec fields[AT_AMPLITUDES + MOST_BANDS + LANES], *amplitudes = fields + AT_AMPLITUDES;
    read_side_by_side(&source, 0, bins, counts);
    read_fields(rows, AT_AMPLITUDES + bands, fields);
    for (int k = 0; k < bands; k++)
        amplitudes[k] = greater(amplitudes[k], (vec){0});
    vec ratio = fill(NAN), score = ratio;
    if (tested) {
        expect_pulses(&tables->wide, phase, amplitudes, scratch->work);
        ratio = likelihood_ratios(tables, counts, scratch->work, fields[AT_TOTAL],
                                  fields[AT_BACKGROUND]);
    }
    if (tables->rules.assessed)
        score = screen(tables, chunk->tests, phase, scratch->curves, counts, amplitudes,
                       fields[AT_BACKGROUND], scratch->work, &chi);
    for (int lane = 0; lane < count; lane++) {
        int p = pixels[lane];
        detection[p] = scratch->tested[p] ? (double)ratio[lane] : (double)NAN;
        chi_square[p] = (double)chi[lane];
        misfit[p] = (double)score[lane];
    }
}

/* Tests of all pixels: of those that ask for it by their score the full one. */
INLINE void test_all(const Chunk *chunk, double *detection, double *chi_square, double *misfit)
{
    const ModelTables *tables = chunk->tables;
    const Scratch *scratch = chunk->scratch;
    int count = 0, asked = 0, some, curved = -1;
    for (int p = 0; p < chunk->count; p++) {
        scratch->phase[p] = phase_of(&tables->wide, scratch->arrivals[p]);
        detection[p] = chi_square[p] = misfit[p] = (double)NAN;
        if (tables->rules.assessed || scratch->tested[p])
            scratch->active[count++] = p;
    }
    sort_by_phase(scratch->phase, tables->wide.phases, scratch->active, count, scratch->places,
                  scratch->sorted);
    for (int i = 0; i < count; i += some) {
        int phase = scratch->phase[scratch->sorted[i]];
        if (tables->rules.assessed && phase != curved)
            curve_runs(tables, phase, scratch->curves);
        curved = phase;
        some = same_phase(scratch->phase, scratch->sorted + i, count - i);
        test_group(chunk, scratch->sorted + i, some, detection, chi_square, misfit);
    }
    for (int p = 0; p < chunk->count; p++)
        if (misfit[p] > (double)tables->rules.asked)
            scratch->active[asked++] = p;
    for (int i = 0; i < asked; i += LANES) {
        const int32_t *pixels = scratch->active + i;
        some = asked - i < LANES ? asked - i : LANES;
        vec score = full_scores(tables, chunk->tests, scratch->wide, scratch->wide_stride,
                                scratch->arrivals, scratch->tracks, pixels, some, scratch->work,
                                scratch->equations);
        for (int lane = 0; lane < some; lane++)
            misfit[pixels[lane]] = (double)score[lane];
    }
}

INLINE void fit_chunk(Chunk *chunk, const Light *light, const int64_t *which, const float *offsets,
                      const float *rates, const Results *results, size_t first)
{
    const Scratch *scratch = chunk->scratch;
    const FitRules *rules = &chunk->tables->rules;
    int made = chunk->count, left;
    locate(chunk, light, which, rates);
    for (int p = 0; p < chunk->count; p++) {
        scratch->offsets[p] = offsets[p];
        scratch->others[p] = NAN;
    }
    for (int p = 0; p < chunk->count; p += TOGETHER * LANES)
        made = search_groups(chunk, p, made);
    for (left = 0; left < made; left++)
        scratch->active[left] = left;
    if (rules->starts_wide)
        left = step_all(chunk, left, 1);
    for (int round = 0; round < rules->steps && left; round++)
        left = step_all(chunk, left, 0);
    for (int p = 0; p < chunk->count; p++) {
        if (scratch->second[p] >= 0)
            decide(chunk, p);
        conclude(chunk, p, results, first + (size_t)p);
    }
    test_all(chunk, results->detection + first, results->chi_square + first, results->misfit + first);
}

static void fit_pixels(const ModelTables *tables, const Light *light, const int64_t *which,
                       size_t pixels, const float *offsets, const float *rates,
                       const AssessmentTables *tests, const Results *results,
                       const Scratch *scratch)
{
    Chunk chunk = {.tables = tables, .tests = tests, .scratch = scratch};
    size_t size = pixels < CHUNK / 2 ? pixels : LEAST_CHUNK; /* few pixels rarely share a phase */
    for (size_t first = 0; first < pixels; first += (size_t)chunk.count) {
        size_t left = pixels - first;
        chunk.count = (int)(left < size ? left : size);
        chunk.taken = chunk.groups = 0;
        fit_chunk(&chunk, light, which + first, offsets + first, rates ? rates + first : NULL, results,
                  first);
        float filled = (float)chunk.taken / (float)(LANES * chunk.groups + 1);
        if (filled < FILLED_LITTLE && size < CHUNK)
            size *= 2;
        else if (filled > FILLED_WELL && size > LEAST_CHUNK)
            size /= 2;
    }
}
