/* SPDX-License-Identifier: Apache-2.0 */
/* The first search: the likelihood of all lags, a vector of lags at once. */

/* Log-likelihood of every lag of BATCH pixels, and which share of background each had; scores
 * outside a pixel's range are −∞. The tables are larger than the nearest cache: what is read of
 * them serves all pixels. */
INLINE void search_lags(const ModelTables *tables, const float *counts, size_t stride,
                        const float *totals, const float *offsets, float *scores, int8_t *tried,
                        size_t room)
{
    const SearchTables *search = &tables->search;
    const FitRules *rules = &tables->rules;
    int blocks = (search->lags + LANES - 1) / LANES;
    for (int block = 0; block < blocks; block++) {
        vec parts[BATCH][MOST_BANDS][RATIOS];
        const int32_t *places = search->span_places + (size_t)block * (size_t)tables->bands;
        for (int k = 0; k < tables->bands; k++) {
            vec some[BATCH][RATIOS] = {{{0}}};
            for (int i = places[k]; i < places[k + 1]; i++) {
                const int32_t *span = search->spans + (size_t)i * 3;
                const float *gains = search->gains + (size_t)span[2];
                for (int j = span[0]; j < span[1]; j++, gains += RATIOS * LANES)
                    for (int p = 0; p < BATCH; p++) {
                        float h = counts[(size_t)p * stride + (size_t)j];
                        for (int r = 0; r < RATIOS; r++)
                            some[p][r] += h * load(gains + r * LANES);
                    }
            }
            for (int p = 0; p < BATCH; p++)
                for (int r = 0; r < RATIOS; r++)
                    parts[p][k][r] = some[p][r];
        }
        for (int p = 0; p < BATCH; p++) {
            vec best = fill(-INFINITY);
            ivec which = {0};
            for (int s = 0; s < BACKGROUND_SHARES; s++) {
                float background = rules->background_shares[s] * totals[p];
                vec score = fill(totals[p] * rules->background_logs[s] - background);
                const float *cost = search->costs + (size_t)block * (size_t)tables->bands * RATIOS * LANES;
                for (int k = 0; k < tables->bands; k++, cost += RATIOS * LANES) {
                    vec gained = {0};
                    for (int r = 0; r < RATIOS; r++)
                        gained = greater(gained, parts[p][k][r] - background * load(cost + r * LANES));
                    score += gained;
                }
                ivec better = score > best;
                best = choose(better, score, best);
                which = (better & (s - (ivec){0})) | (~better & which);
            }
            store(scores + (size_t)p * room + block * LANES, best);
            for (int lane = 0; lane < LANES; lane++)
                tried[(size_t)p * room + (size_t)(block * LANES + lane)] = (int8_t)which[lane];
        }
    }
    float margin = search->lags > 1 ? search->step_ns / 2 : INFINITY;
    for (int p = 0; p < BATCH; p++) {
        float low = offsets[p] + rules->low_ns - margin, high = offsets[p] + rules->high_ns + margin;
        for (int lag = 0; lag < search->lags; lag++) {
            float at = search->first_ns + (float)lag * search->step_ns;
            if (at < low || at > high)
                scores[(size_t)p * room + (size_t)lag] = -INFINITY;
        }
    }
}

/* Highest lag, and the highest that is farther off: −1 if there is none. */
INLINE void two_best(const SearchTables *search, const float *scores, int *best, int *second)
{
    *best = 0;
    for (int lag = 1; lag < search->lags; lag++)
        if (scores[lag] > scores[*best])
            *best = lag;
    *second = -1;
    for (int lag = 0; lag < search->lags; lag++) {
        int far = lag > *best ? lag - *best : *best - lag;
        if (far >= search->separation && isfinite(scores[lag])
            && (*second < 0 || scores[lag] > scores[*second]))
            *second = lag;
    }
}

/* First values of a candidate: delay from a parabola through three lags, amplitudes from the bands' zones,
 * background from the bins in none of them. */
INLINE void start(const ModelTables *tables, const float *counts, float total, const float *scores,
                  const int8_t *tried, int lag, Candidate *candidate)
{
    const SearchTables *search = &tables->search;
    float shift = 0;
    if (lag > 0 && lag < search->lags - 1) {
        float left = scores[lag - 1], right = scores[lag + 1];
        float bend = left - 2 * scores[lag] + right;
        if (isfinite(bend) && bend < 0) {
            shift = 0.5f * (left - right) / bend;
            shift = shift > 0.5f ? 0.5f : shift < -0.5f ? -0.5f : shift;
        }
    }
    candidate->delay = search->first_ns + ((float)lag + shift) * search->step_ns;
    candidate->steps = 0;
    candidate->live = 1;
    float inside[MOST_BANDS] = {0}, dark = total, dark_width = 1;
    for (int run = search->places[lag]; run < search->places[lag + 1]; run++) {
        const int32_t *bins = search->runs + (size_t)run * 3;
        float here = 0;
        for (int j = bins[1]; j < bins[2]; j++)
            here += counts[j];
        inside[bins[0]] += here;
    }
    const float *widths = search->widths + (size_t)lag * (size_t)tables->bands;
    const float *shares = search->shares + (size_t)lag * (size_t)tables->bands;
    for (int k = 0; k < tables->bands; k++) {
        dark -= inside[k];
        dark_width -= widths[k];
    }
    candidate->background = dark_width > tables->rules.dark_width
                            ? dark / dark_width
                            : tables->rules.background_shares[tried[lag]] * total;
    for (int k = 0; k < tables->bands; k++) {
        float share = shares[k] > LEAST_SHARE ? shares[k] : LEAST_SHARE;
        float a = (inside[k] - candidate->background * widths[k]) / share;
        candidate->amplitudes[k] = a > 0 ? a : 0;
    }
}
