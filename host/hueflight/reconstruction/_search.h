/* The first search: the likelihood of all lags, sixteen lags a vector. */

/* Log-likelihood of every lag, and which share of background it had; scores outside the pixel's
 * range are −∞. `scores` and `tried` have room for whole vectors of lags. */
INLINE void search(const Plan *plan, const float *counts, float total, float offset, float *scores,
                   int8_t *tried)
{
    const Coarse *coarse = &plan->coarse;
    const Rules *rules = &plan->rules;
    int blocks = (coarse->lags + LANES - 1) / LANES;
    for (int block = 0; block < blocks; block++) {
        vec parts[MOST_BANDS][RATIOS];
        const int32_t *span = coarse->spans + (size_t)block * (size_t)plan->bands * 3;
        for (int k = 0; k < plan->bands; k++, span += 3) {
            vec a = {0}, b = {0}, c = {0};
            const float *gains = coarse->gains + (size_t)span[2];
            for (int j = span[0]; j < span[1]; j++, gains += RATIOS * LANES) {
                float h = counts[j];
                a += h * load(gains);
                b += h * load(gains + LANES);
                c += h * load(gains + 2 * LANES);
            }
            parts[k][0] = a;
            parts[k][1] = b;
            parts[k][2] = c;
        }
        vec best = fill(-INFINITY);
        ivec which = {0};
        for (int s = 0; s < SHARES; s++) {
            float background = rules->shares[s] * total;
            vec score = fill(total * rules->logs[s] - background);
            const float *cost = coarse->costs + (size_t)block * (size_t)plan->bands * RATIOS * LANES;
            for (int k = 0; k < plan->bands; k++, cost += RATIOS * LANES) {
                vec gained = greater(parts[k][0] - background * load(cost),
                                     parts[k][1] - background * load(cost + LANES));
                gained = greater(gained, parts[k][2] - background * load(cost + 2 * LANES));
                score += greater(gained, (vec){0});
            }
            ivec better = score > best;
            best = choose(better, score, best);
            which = (better & (s - (ivec){0})) | (~better & which);
        }
        for (int lane = 0; lane < LANES; lane++) {
            scores[block * LANES + lane] = best[lane];
            tried[block * LANES + lane] = (int8_t)which[lane];
        }
    }
    float margin = coarse->lags > 1 ? coarse->step_ns / 2 : INFINITY;
    float low = offset + rules->low_ns - margin, high = offset + rules->high_ns + margin;
    for (int lag = 0; lag < coarse->lags; lag++) {
        float at = coarse->first_ns + (float)lag * coarse->step_ns;
        if (at < low || at > high)
            scores[lag] = -INFINITY;
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

/* First guess of a track: a parabola through three lags, amplitudes from the bands' zones. */
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
    track->background = plan->rules.shares[tried[lag]] * total;
    track->steps = 0;
    track->live = 1;
    float inside[MOST_BANDS + 1] = {0};
    const int8_t *owners = coarse->owners + (size_t)lag * (size_t)coarse->bins;
    for (int j = 0; j < coarse->bins; j++)
        inside[owners[j] < 0 ? MOST_BANDS : owners[j]] += counts[j];
    const float *widths = coarse->widths + (size_t)lag * (size_t)plan->bands;
    const float *shares = coarse->shares + (size_t)lag * (size_t)plan->bands;
    for (int k = 0; k < plan->bands; k++) {
        float share = shares[k] > 1e-3f ? shares[k] : 1e-3f;
        float a = (inside[k] - track->background * widths[k]) / share;
        track->amplitudes[k] = a > 0 ? a : 0;
    }
}
