/* SPDX-License-Identifier: Apache-2.0 */
/* Correlation of LANES pixels at once with their references. Counts are whole numbers, so that sums
 * of them are exact. */

/* What all pixels share. Lags are counted from −most to most; references are continued around the
 * circle by `most` bins on both sides. */
typedef struct {
    int bins, search, reach, most, circular, windows, bands, gaps, outside;
    double half_width;
    const int32_t *window, *gap; /* (band, start, stop) each; (start, stop) of bins in no window */
    const uint16_t *references;
    const double *pixel_delays;
} Paper;

static const Light REFERENCES = {.bin_step = 2, .type = 'H'}; /* how they lie */

#define LAGS 12 /* correlated at once: their sums stay in registers */
#define STRETCH 84 /* factors that stay in the cache for all lags */

/* Of the pixels side by side. `running` are the counts of light before each bin and go on around
 * the circle, `shifted` those of the references moved later by the pixels' delays. `first` and
 * `second` are the correlation's factors: the light's, and the reference's with zeros about it.
 * `correlation` and the integrals of its peak, `mass` and `moment`, are counted from lag 0. */
typedef struct {
    ivec *running, *shifted, *first, *second;
    vec *correlation;
    double *mass, *moment;
    const char *light[LANES], *reference[LANES]; /* first bins */
    const char *next[2 * LANES]; /* lowest places of what is read next */
    int narrow;    /* factors are pairs of neighbouring bins of 15 bits, otherwise floats */
    int low, high; /* lags that are computed already */
} Group;

/* Where these pixels and the next have their counts; the last once more in lanes that are left. */
INLINE void find_rows(const Paper *paper, Group *group, const Light *light, const int64_t *which,
                      size_t at, size_t end)
{
    Py_ssize_t lowest = light->bin_step < 0 ? (paper->bins - 1) * light->bin_step : 0;
    Py_ssize_t stride = paper->bins + 2 * paper->most;
    for (size_t lane = 0; lane < LANES; lane++) {
        size_t here = at + lane, there = here + LANES;
        Py_ssize_t pixel = which[here < end ? here : end - 1];
        Py_ssize_t next = which[there < end ? there : end - 1];
        const uint16_t *references = paper->references + paper->most;
        group->light[lane] = light->data + pixel * light->pixel_step;
        group->reference[lane] = (const char *)(references + pixel * stride);
        group->next[2 * lane] = light->data + next * light->pixel_step + lowest;
        group->next[2 * lane + 1] = (const char *)(references + next * stride);
    }
}

/* Prefetches the `i`-th part of what is read next; there are as many parts as bins. Processors drop
 * some of too many prefetches at a time. */
INLINE void fetch_next(const Group *group, size_t i)
{
    __builtin_prefetch(group->next[i % (2 * LANES)] + i / (2 * LANES) * 64);
}

/* Makes running sums and factors that are pairs of bins. False if some counts are too large for
 * that. */
INLINE int make_pairs(const Paper *paper, Group *group, const Light *light)
{
    ivec pairs[LANES], before = {0}, last = {0}, seen = {0};
    int bins = paper->bins, at;
    for (at = 0; at < bins; at += 2 * LANES) {
        seen |= transposed_pairs(light, group->light, at, bins, pairs);
        before = transposed_running_sums(pairs, before, group->running + at);
        memcpy(group->first + at / 2, pairs, sizeof pairs);
    }
    group->running[at] = before;
    for (at = 0; at < bins; at += 2 * LANES) {
        seen |= transposed_pairs(&REFERENCES, group->reference, at, bins, pairs);
        ivec *second = group->second + at;
        for (int i = 0; i < LANES; i++) {
            second[2 * i - 1] = across(last, pairs[i]);
            second[2 * i] = last = pairs[i];
        }
    }
    group->second[at - 1] = across(last, (ivec){0});
    return !any((seen & (ivec)((uvec){0} + 0x80008000u)) | (before > 0x7fff));
}

/* The same with factors that are floats, of any counts. */
INLINE void make_floats(const Paper *paper, Group *group, const Light *light)
{
    ivec counts[2 * LANES], before = {0};
    int bins = paper->bins, at;
    for (at = 0; at < bins; at += 2 * LANES) {
        transposed_counts(light, group->light, at, bins, counts);
        for (int i = 0; i < 2 * LANES; i++) {
            group->first[at + i] = (ivec)__builtin_convertvector(counts[i], vec);
            group->running[at + i] = before;
            before += counts[i];
        }
    }
    group->running[at] = before;
    for (at = 0; at < bins; at += 2 * LANES) {
        transposed_counts(&REFERENCES, group->reference, at, bins, counts);
        for (int i = 0; i < 2 * LANES; i++)
            group->second[at + i] = (ivec)__builtin_convertvector(counts[i], vec);
    }
    group->second[-1] = (ivec){0};
}

/* Running sums and factors of these pixels; no lag is computed yet. */
INLINE void prepare_group(const Paper *paper, Group *group, const Light *light)
{
    int bins = paper->bins;
    group->narrow = make_pairs(paper, group, light);
    if (!group->narrow)
        make_floats(paper, group, light);
    ivec all = group->running[bins];
    for (int i = -paper->reach; i < 0; i++)
        group->running[i] = group->running[bins + i] - all;
    for (int i = 1; i <= paper->reach + 1; i++)
        group->running[bins + i] = group->running[i] + all;
    group->low = group->high = -paper->search;
}

/* Adds up what `count` factors from `from` on contribute to LAGS lags. */
INLINE void correlate_some(const Group *group, int from, int count, int lag, int narrow)
{
    int step = narrow ? 2 : 1;
    const ivec *light = group->first + from, *reference = group->second + from * step - lag;
    ivec sums[LAGS], *kept = (ivec *)group->correlation + lag;
    for (int k = 0; k < LAGS; k++)
        sums[k] = kept[k];
    for (; count--; light++, reference += step) {
        __asm__("" : "+r"(reference)); /* or some compilers keep loads for later, and spill sums */
        for (int k = 0; k < LAGS; k++)
            sums[k] = narrow ? sums[k] + pair_products(*light, reference[-k])
                             : (ivec)((vec)sums[k] + (vec)*light * (vec)reference[-k]);
    }
    for (int k = 0; k < LAGS; k++)
        kept[k] = sums[k];
}

/* Correlation at the lags [from, to), whole LAGS of them. */
INLINE void correlate(const Paper *paper, const Group *group, int from, int to)
{
    int narrow = group->narrow, factors = narrow ? (paper->bins + 1) / 2 : paper->bins;
    memset(group->correlation + from, 0, (size_t)(to - from) * sizeof(vec));
    for (int at = 0; at < factors; at += STRETCH) {
        int count = factors - at < STRETCH ? factors - at : STRETCH;
        for (int lag = from; lag < to; lag += LAGS) {
            if (narrow)
                correlate_some(group, at, count, lag, 1);
            else
                correlate_some(group, at, count, lag, 0);
        }
    }
    for (int lag = from; narrow && lag < to; lag++)
        group->correlation[lag] = __builtin_convertvector((ivec)group->correlation[lag], vec);
}

/* Computes the lags from `from` up to `to`; returns whether some were missing. */
INLINE int extend(const Paper *paper, Group *group, int from, int to)
{
    int low = group->low, high = group->high;
    while (group->low > from)
        group->low -= LAGS;
    while (group->high < to)
        group->high += LAGS;
    correlate(paper, group, group->low, low);
    correlate(paper, group, high, group->high);
    return group->low < low || group->high > high;
}
