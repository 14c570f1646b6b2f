/* The first search: the likelihood of all lags, a vector of lags at once. */

/* Log-likelihood of every lag of PARTY pixels, and which share of background each had; scores
 * outside a pixel's range are −∞. The tables are larger than the nearest cache: what is read of
 * them serves all pixels. */
INLINE void search(const Plan *plan, const float *counts, size_t stride, const float *totals,
                   const float *offsets, float *scores, int8_t *tried, size_t room)
{
    const Coarse *coarse = &plan->coarse;
    const Rules *rules = &plan->rules;
    int blocks = (coarse->lags + LANES - 1) / LANES;
    for (int block = 0; block < blocks; block++) {
        vec parts[PARTY][MOST_BANDS][RATIOS];
        const int32_t *span = coarse->spans + (size_t)block * (size_t)plan->bands * 3;
        for (int k = 0; k < plan->bands; k++, span += 3) {
            vec some[PARTY][RATIOS] = {{{0}}};
            const float *gains = coarse->gains + (size_t)span[2];
            for (int j = span[0]; j < span[1]; j++, gains += RATIOS * LANES)
                for (int p = 0; p < PARTY; p++) {
                    float h = counts[(size_t)p * stride + (size_t)j];
                    for (int r = 0; r < RATIOS; r++)
                        some[p][r] += h * load(gains + r * LANES);
                }
            for (int p = 0; p < PARTY; p++)
                for (int r = 0; r < RATIOS; r++)
                    parts[p][k][r] = some[p][r];
        }
        for (int p = 0; p < PARTY; p++) {
            vec best = fill(-INFINITY);
            ivec which = {0};
            for (int s = 0; s < SHARES; s++) {
                float background = rules->shares[s] * totals[p];
                vec score = fill(totals[p] * rules->logs[s] - background);
                const float *cost = coarse->costs + (size_t)block * (size_t)plan->bands * RATIOS * LANES;
                for (int k = 0; k < plan->bands; k++, cost += RATIOS * LANES) {
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
    float margin = coarse->lags > 1 ? coarse->step_ns / 2 : INFINITY;
    for (int p = 0; p < PARTY; p++) {
        float low = offsets[p] + rules->low_ns - margin, high = offsets[p] + rules->high_ns + margin;
        for (int lag = 0; lag < coarse->lags; lag++) {
            float at = coarse->first_ns + (float)lag * coarse->step_ns;
            if (at < low || at > high)
                scores[(size_t)p * room + (size_t)lag] = -INFINITY;
        }
    }
}

/* Highest lag, and the highest that is farther off: −1 if there is none. */
INLINE void two_best(const Coarse *coarse, const float *scores, int *best, int *second)
{
    *best = 0;
    for (int lag = 1; lag < coarse->lags; lag++)
        if (scores[lag] > scores[*best])
            *best = lag;
    *second = -1;
    for (int lag = 0; lag < coarse->lags; lag++) {
        int far = lag > *best ? lag - *best : *best - lag;
        if (far >= coarse->separation && isfinite(scores[lag])
            && (*second < 0 || scores[lag] > scores[*second]))
            *second = lag;
    }
}

/* First guess of a track: a parabola through three lags, amplitudes from the bands' zones,
 * background from the bins in none of them. */
INLINE void start(const Plan *plan, const float *counts, float total, const float *scores,
                  const int8_t *tried, int lag, Track *track)
{
    const Coarse *coarse = &plan->coarse;
    float shift = 0;
    if (lag > 0 && lag < coarse->lags - 1) {
        float left = scores[lag - 1], right = scores[lag + 1];
        float bend = left - 2 * scores[lag] + right;
        if (isfinite(bend) && bend < 0) {
            shift = 0.5f * (left - right) / bend;
            shift = shift > 0.5f ? 0.5f : shift < -0.5f ? -0.5f : shift;
        }
    }
    track->delay = coarse->first_ns + ((float)lag + shift) * coarse->step_ns;
    track->steps = 0;
    track->live = 1;
    float inside[MOST_BANDS] = {0}, dark = total, dark_width = 1;
    for (int run = coarse->places[lag]; run < coarse->places[lag + 1]; run++) {
        const int16_t *bins = coarse->runs + (size_t)run * 3;
        float here = 0;
        for (int j = bins[1]; j < bins[2]; j++)
            here += counts[j];
        inside[bins[0]] += here;
    }
    const float *widths = coarse->widths + (size_t)lag * (size_t)plan->bands;
    const float *shares = coarse->shares + (size_t)lag * (size_t)plan->bands;
    for (int k = 0; k < plan->bands; k++) {
        dark -= inside[k];
        dark_width -= widths[k];
    }
    track->background = dark_width > plan->rules.dark_width
                            ? dark / dark_width
                            : plan->rules.shares[tried[lag]] * total;
    for (int k = 0; k < plan->bands; k++) {
        float share = shares[k] > 1e-3f ? shares[k] : 1e-3f;
        float a = (inside[k] - track->background * widths[k]) / share;
        track->amplitudes[k] = a > 0 ? a : 0;
    }
}
