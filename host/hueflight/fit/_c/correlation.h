/* SPDX-License-Identifier: Apache-2.0 */
/* Correlation of LANES pixels at once with their references. Counts are whole numbers, so that sums
 * of them are exact. */

/* What all pixels share. Lags are counted from −most to most; references are continued around the
 * circle by `most` bins on both sides. */
typedef struct {
    int bins, search, reach, most, highest, circular, windows, bands, gaps, outside;
    double half_width;
    const int32_t *window, *gap; /* (band, start, stop) each; (start, stop) of bins in no window */
    const uint16_t *references;
    const double *pixel_delays;
} Paper;

static const Light REFERENCES = {.bin_step = 2, .type = 'H'}; /* how they lie */

#ifdef __SSE2__
#define KEPT(X) __asm__("" : "+v"(X)) /* in a register */
#else
#define KEPT(X)
#endif
#define LAGS 12 /* correlated at once: their sums stay in registers */
#define STRETCH 84 /* factors that stay in the cache for all lags */
enum { WORD_STRETCH = 32, LEAST_STRETCH = 8 }; /* the same of factors that are four bytes */

/* Of the pixels side by side. `running` are the counts of light before each bin and go on around
 * the circle, `shifted` those of the references moved later by the pixels' delays. `first` and
 * `second` are the correlation's factors: the light's, and the reference's with zeros about it.
 * `correlation` and the integrals of its peak, `mass` and `moment`, are counted from lag 0. */
typedef struct {
    ivec *running; /* floats, which are exact, unless factors are of one bin */
    vec *shifted;
    ivec *first, *second;
    vec *correlation;
    double *mass, *moment;
    const char *light[LANES], *reference[LANES]; /* first bins */
    const char *next[2 * LANES]; /* lowest places of what is read next, a line of the cache at a time */
    int step;      /* bins of a factor: a float, a pair of 15 bits or four bytes */
    int stretch;   /* factors of four bytes whose products are added up in 16 bits */
    int low, high; /* lags that are computed already */
    size_t fetched, fetches; /* parts of `next` that were prefetched, and all of them */
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

/* Prefetches the next part of what is read next: processors drop some of too many at a time. It goes
 * into the second cache, since what is computed now fills the first. */
INLINE void fetch_next(Group *group)
{
    size_t part = group->fetched++;
    if (part < group->fetches)
        __builtin_prefetch(group->next[part % (2 * LANES)] + part / (2 * LANES) * 64, 0, 2);
}

/* Running sums of the light, and its factors as pairs of bins; returns all bits that a count has, also
 * where the sum of all has more than 15. */
APART int32_t pair_light(const Paper *paper, Group *group, const Light *light)
{
    ivec pairs[LANES], before = {0}, seen = {0};
    int bins = paper->bins, at;
    for (at = 0; at < bins; at += 2 * LANES) {
        seen |= transposed_pairs(light, group->light, at, bins, pairs);
        before = transposed_running_sums(pairs, before, (vec *)group->running + at);
        for (int i = 0; i < LANES; i++)
            group->first[at / 2 + i] = pairs[i];
    }
    group->running[at] = (ivec)__builtin_convertvector(before, vec);
    int32_t bits = any(seen);
    return (bits >> 16 | bits | any(before > 0x7fff)) & 0xffff;
}

/* Factors of the references that hold `step` bins from each bin on. */
INLINE void pair_references(const Paper *paper, Group *group, int step)
{
    ivec pairs[LANES + 1] = {{0}}, *second = group->second, odd = {0};
    for (int at = 0; at < paper->bins; at += 2 * LANES, second += 2 * LANES) {
        transposed_pairs(&REFERENCES, group->reference, at, paper->bins, pairs + 1);
        for (int i = 0; i < LANES; i++) {
            ivec between = across(pairs[i], pairs[i + 1]);
            second[2 * i + 1 - step] = step == 4 ? odd | between << 8 : between;
            second[2 * i + 2 - step] = step == 4 ? pairs[i] | pairs[i + 1] << 8 : pairs[i + 1];
            odd = between;
        }
        pairs[0] = pairs[LANES];
    }
    second[-1] = across(pairs[0], (ivec){0});
    if (step == 4) {
        second[-3] = odd | second[-1] << 8;
        second[-2] = pairs[0];
    }
}

APART void make_pairs(const Paper *paper, Group *group) { pair_references(paper, group, 2); }

/* Factors of four bytes, the light's from its pairs. */
APART void make_words(const Paper *paper, Group *group)
{
    for (int i = 0; i < paper->bins; i += 4)
        group->first[i / 4] = group->first[i / 2] | group->first[i / 2 + 1] << 8;
    pair_references(paper, group, 4);
}

/* How many factors of four bytes may be added up in 16 bits, 0 if too few: two products are added up
 * with a sign, and those of a stretch are no more than its photons times the highest reference. */
INLINE int byte_stretch(const Paper *paper, const Group *group, int32_t bits)
{
    int bins = paper->bins, most = 1;
    while (most < bits)
        most = 2 * most + 1;
    if (!BYTE_PRODUCTS || most > 0x7f || paper->highest > 0xff || 2 * most * paper->highest > 0x7fff)
        return 0;
    const vec *running = (const vec *)group->running;
    for (int stretch = WORD_STRETCH; stretch >= LEAST_STRETCH; stretch /= 2) {
        ivec above = {0};
        for (int at = 0; at < bins; at += 4 * stretch) {
            int end = at + 4 * stretch < bins ? at + 4 * stretch : bins;
            above |= (running[end] - running[at]) * (float)paper->highest > 65535.0f;
        }
        if (!any(above))
            return stretch;
    }
    return 0;
}

/* The same with factors that are floats, of any counts. */
APART void make_floats(const Paper *paper, Group *group, const Light *light)
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
    int bins = paper->bins, reach = paper->reach;
    for (int i = -3; i < 0; i++)
        group->second[i] = (ivec){0};
    int32_t bits = pair_light(paper, group, light);
    group->stretch = byte_stretch(paper, group, bits);
    group->step = group->stretch ? 4 : bits <= 0x7fff && paper->highest <= 0x7fff ? 2 : 1;
    if (group->step == 4)
        make_words(paper, group);
    else if (group->step == 2)
        make_pairs(paper, group);
    else
        make_floats(paper, group, light);
    group->low = group->high = -paper->search;
    group->fetched = 0;
    group->fetches = 2 * LANES * ((size_t)(paper->bins + paper->most) * 2 / 64 + 1);
    ivec *running = group->running, all = running[bins];
    for (int i = -reach; i < 0; i++)
        running[i] = group->step == 1 ? running[bins + i] - all
                                      : (ivec)((vec)running[bins + i] - (vec)all);
    for (int i = 1; i <= reach + 1; i++)
        running[bins + i] = group->step == 1 ? running[i] + all
                                             : (ivec)((vec)running[i] + (vec)all);
}

/* Adds the products of one factor to the sums of LAGS lags. */
INLINE void add_products(ivec *sums, ivec light, const ivec *reference, int step)
{
    for (int k = 0; k < LAGS; k++) {
        sums[k] = step == 4   ? add_byte_products(sums[k], reference[-k], light)
                  : step == 2 ? sums[k] + pair_products(light, reference[-k])
                              : (ivec)((vec)sums[k] + (vec)light * (vec)reference[-k]);
        if (step == 4)
            KEPT(sums[k]); /* or some compilers keep loads for later, and spill sums */
    }
}

/* Adds up what `count` factors from `from` on contribute to LAGS lags. */
INLINE void correlate_some(Group *group, int from, int count, int lag, int step)
{
    const ivec *light = group->first + from, *reference = group->second + from * step - lag;
    ivec sums[LAGS], *kept = (ivec *)group->correlation + lag;
    const int each = (step == 4 ? 32 : 64) / LANES; /* factors for which a part is prefetched */
    for (int k = 0; k < LAGS; k++)
        sums[k] = step == 4 ? (ivec){0} : kept[k];
    for (; count >= each; count -= each) {
        fetch_next(group);
        for (int i = 0; i < each; i++, light++, reference += step) {
            __asm__("" : "+r"(reference)); /* for the same reason */
            add_products(sums, *light, reference, step);
        }
    }
    for (; count; count--, light++, reference += step) {
        __asm__("" : "+r"(reference));
        add_products(sums, *light, reference, step);
    }
    for (int k = 0; k < LAGS; k++)
        kept[k] = step == 4 ? kept[k] + first_of(sums[k]) + second_of(sums[k]) : sums[k];
}

/* Correlation at the lags [from, to), whole LAGS of them. */
APART void correlate(const Paper *paper, Group *group, int from, int to)
{
    int step = group->step, stretch = step == 4 ? group->stretch : STRETCH;
    int factors = (paper->bins + step - 1) / step;
    memset(group->correlation + from, 0, (size_t)(to - from) * sizeof(vec));
    for (int at = 0; at < factors; at += stretch) {
        int count = factors - at < stretch ? factors - at : stretch;
        for (int lag = from; lag < to; lag += LAGS) {
            if (step == 4)
                correlate_some(group, at, count, lag, 4);
            else if (step == 2)
                correlate_some(group, at, count, lag, 2);
            else
                correlate_some(group, at, count, lag, 1);
        }
    }
    for (int lag = from; step > 1 && lag < to; lag++)
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
