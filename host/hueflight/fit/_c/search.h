/* SPDX-License-Identifier: Apache-2.0 */
/* The first search: the likelihood of all lags of TOGETHER groups of pixels, one pixel in each lane.
 * Several groups share what is read of the tables, and keep the processor's units busy. */
enum { TOGETHER = 2 };

/* What the search of one group leaves behind. */
typedef struct {
    ivec best, second; /* lags; the second is −1 where there is none */
    vec worse;         /* log-likelihood by which the second is worse */
} Found;

/* Rows of counts that are wanted next: a few are fetched with each lag, as memory keeps up with. */
typedef struct {
    const Light *light;
    const char *const *rows;
    int count, bins;
} Upcoming;

/* Sums of bins up to `bins` by fours, for each sum one vector a group; returns the sum of all. */
APART vec sum_by_four(const Source *source, int bins, vec *counts, vec *wide)
{
    int block = source->light->type == 'H' ? 8 : 4, back = source->light->bin_step < 0, ready = 0;
    vec total = {0}, made[2];
    for (; ready + block <= bins; ready += block) {
        if (block == 4)
            made[0] = sum_four_32(source, ready);
        else if (back)
            sum_eight_16(source, ready, 1, made);
        else
            sum_eight_16(source, ready, 0, made);
        for (int i = 0; i < block / 4; i++, wide += TOGETHER) {
            *wide = made[i];
            total += made[i];
        }
    }
    if (ready < bins)
        read_side_by_side(source, ready, bins, counts);
    for (; ready < bins; wide += TOGETHER) {
        vec x = counts[ready++];
        for (int i = 1; i < 4 && ready < bins; i++)
            x += counts[ready++];
        *wide = x;
        total += x;
    }
    return total;
}

/* Sums of each pixel's fine bins at the bins of the search, for each bin one vector a group; returns
 * the sum of all bins of group `mine`. */
INLINE vec sum_abreast(const ModelTables *tables, const Source *source, vec *fine, vec *wide, int mine)
{
    int factor = tables->search.factor;
    vec total = {0};
    wide += mine;
    if (tables->views == 1 && factor == 4)
        return sum_by_four(source, tables->fine.bins, fine, wide);
    read_side_by_side(source, 0, tables->fine.bins, fine);
    for (int v = 0; v < tables->views; v++) {
        int size = (tables->sizes[v] + tables->factor - 1) / tables->factor;
        for (int first = 0; first < size; first += factor, wide += TOGETHER) {
            int some = size - first < factor ? size - first : factor;
            vec x = *fine++;
            for (int i = 1; i < some; i++)
                x += *fine++;
            *wide = x;
            total += x;
        }
    }
    return total;
}

/* Log-likelihood of every lag and which share of background it had, for each lag one vector a group;
 * scores outside a pixel's range are −∞. */
APART void search_lags(const ModelTables *tables, const vec *wide, const vec *totals,
                        const vec *offsets, const Upcoming *next, vec *scores, vec *shares)
{
    const SearchTables *search = &tables->search;
    const FitRules *rules = &tables->rules;
    float margin = search->lags > 1 ? search->step_ns / 2 : INFINITY;
    for (int lag = 0; lag < search->lags; lag++) {
        int wanted = next->count * (lag + 1) / search->lags;
        for (int row = next->count * lag / search->lags; row < wanted; row++)
            fetch_row(next->light, next->rows[row], next->bins);
        vec score[BACKGROUND_SHARES][TOGETHER];
        for (int s = 0; s < BACKGROUND_SHARES; s++)
            for (int g = 0; g < TOGETHER; g++)
                score[s][g] = totals[g] * rules->background_logs[s]
                            - totals[g] * rules->background_shares[s];
        int i = search->gain_places[lag], end = search->gain_places[lag + 1];
        while (i < end) {
            int band = search->gain_runs[i].band;
            vec some[TOGETHER][RATIOS] = {{{0}}};
            for (; i < end && search->gain_runs[i].band == band; i++) {
                GainRun run = search->gain_runs[i];
                const float *gains = search->gains + run.place;
                for (int j = run.first; j < run.last; j++, gains += RATIOS)
                    for (int g = 0; g < TOGETHER; g++)
                        for (int r = 0; r < RATIOS; r++)
                            some[g][r] += wide[j * TOGETHER + g] * gains[r];
            }
            const float *cost = search->costs + (size_t)(lag * tables->bands + band)
                                                    * BACKGROUND_SHARES * RATIOS;
            for (int s = 0; s < BACKGROUND_SHARES; s++, cost += RATIOS)
                for (int g = 0; g < TOGETHER; g++) {
                    vec gained = {0};
                    for (int r = 0; r < RATIOS; r++)
                        gained = greater(gained, some[g][r] - totals[g] * cost[r]);
                    score[s][g] += gained;
                }
        }
        float at = search->first_ns + (float)lag * search->step_ns;
        for (int g = 0; g < TOGETHER; g++) {
            vec best = score[0][g], share = fill(rules->background_shares[0]);
            for (int s = 1; s < BACKGROUND_SHARES; s++) {
                ivec better = score[s][g] > best;
                best = choose(better, score[s][g], best);
                share = choose(better, fill(rules->background_shares[s]), share);
            }
            ivec outside = (at < offsets[g] + rules->low_ns - margin)
                         | (at > offsets[g] + rules->high_ns + margin);
            scores[lag * TOGETHER + g] = choose(outside, fill(-INFINITY), best);
            shares[lag * TOGETHER + g] = share;
        }
    }
}

/* The highest lag of each pixel, and the highest that is farther off. */
INLINE Found two_best(const SearchTables *search, const vec *scores)
{
    Found found = {.second = (ivec){0} - 1};
    vec top = scores[0], next = fill(-INFINITY);
    for (int lag = 1; lag < search->lags; lag++) {
        vec score = scores[lag * TOGETHER];
        ivec above = score > top;
        top = choose(above, score, top);
        found.best = (above & lag) | (~above & found.best);
    }
    for (int lag = 0; lag < search->lags; lag++) {
        vec score = scores[lag * TOGETHER];
        ivec apart = lag - found.best;
        apart = ((apart >= search->separation) | (apart <= -search->separation)) & (score > next);
        next = choose(apart, score, next);
        found.second = (apart & lag) | (~apart & found.second);
    }
    found.worse = choose(found.second >= 0, top - next, fill(INFINITY));
    return found;
}

/* Counts of the pixels in each band's zone at one lag. */
INLINE void sum_zones(const ModelTables *tables, const vec *wide, int lag, vec *inside)
{
    const SearchTables *search = &tables->search;
    memset(inside, 0, sizeof *inside * (size_t)tables->bands);
    for (int run = search->places[lag]; run < search->places[lag + 1]; run++) {
        const int32_t *bins = search->runs + (size_t)run * 3;
        vec here = {0};
        for (int j = bins[1]; j < bins[2]; j++)
            here += wide[j * TOGETHER];
        inside[bins[0]] += here;
    }
}

/* Delays of pixels from a parabola through three lags. */
INLINE vec peak_delays(const SearchTables *search, const vec *scores, ivec lags)
{
    vec left = fill(-INFINITY), here = left, right = left;
    for (int lag = 0; lag < search->lags; lag++) {
        vec score = scores[lag * TOGETHER];
        left = choose(lags - 1 == lag, score, left);
        here = choose(lags == lag, score, here);
        right = choose(lags + 1 == lag, score, right);
    }
    vec bend = left - 2.0f * here + right;
    ivec inner = (bend < 0.0f) & (bend > -INFINITY);
    vec shift = 0.5f * (left - right) / choose(inner, bend, fill(1.0f));
    shift = choose(inner, lesser(greater(shift, fill(-0.5f)), fill(0.5f)), (vec){0});
    return search->first_ns + (__builtin_convertvector(lags, vec) + shift) * search->step_ns;
}

/* First values of tracks at a lag of each pixel: amplitudes from the bands' zones, background from the
 * bins in none of them. Pixels without a lag (−1) get none. */
APART void start(const ModelTables *tables, const vec *wide, vec total, const vec *scores,
                  const vec *tried, ivec lags, vec *fields)
{
    const SearchTables *search = &tables->search;
    int32_t lag_of[LANES];
    memcpy(lag_of, &lags, sizeof lag_of);
    fields[AT_DELAY] = peak_delays(search, scores, lags);
    for (int k = -1; k < tables->bands; k++)
        fields[k < 0 ? AT_BACKGROUND : AT_AMPLITUDES + k] = (vec){0};
    for (int lane = 0; lane < LANES; lane++) {
        int lag = lag_of[lane], done = lag < 0;
        for (int before = 0; before < lane; before++)
            done |= lag_of[before] == lag;
        if (done)
            continue;
        ivec mine = lags == lag;
        vec inside[MOST_BANDS], dark = total;
        float dark_width = 1;
        const float *widths = search->widths + (size_t)lag * (size_t)tables->bands;
        const float *shares = search->shares + (size_t)lag * (size_t)tables->bands;
        sum_zones(tables, wide, lag, inside);
        for (int k = 0; k < tables->bands; k++) {
            dark -= inside[k];
            dark_width -= widths[k];
        }
        vec background = dark_width > tables->rules.dark_width ? dark / dark_width
                                                               : tried[lag * TOGETHER] * total;
        fields[AT_BACKGROUND] = choose(mine, background, fields[AT_BACKGROUND]);
        for (int k = 0; k < tables->bands; k++) {
            float share = shares[k] > LEAST_SHARE ? shares[k] : LEAST_SHARE;
            vec a = greater((inside[k] - background * widths[k]) / share, (vec){0});
            fields[AT_AMPLITUDES + k] = choose(mine, a, fields[AT_AMPLITUDES + k]);
        }
    }
}
