/* SPDX-License-Identifier: Apache-2.0 */
/* The published method on LANES pixels at once: highest correlation, centroid, its deviation, window
 * sums. paper.py is the definition. */

/* One place for each pixel. */
typedef struct {
    double *delay, *deviation, *sums, *background;
} PaperResults;

/* Lowest correlation of the range searched, and where the highest is: the first if several are. */
INLINE vec search_peak(const Paper *paper, const Group *group, double *delay)
{
    vec least = group->correlation[-paper->search], top = least;
    ivec best = (ivec){0} - paper->search;
    for (int lag = 1 - paper->search; lag <= paper->search; lag++) {
        vec c = group->correlation[lag];
        ivec above = c > top;
        best = (above & lag) | (~above & best);
        top = choose(above, c, top);
        least = choose(c < least, c, least);
    }
    for (int lane = 0; lane < LANES; lane++)
        delay[lane] = best[lane];
    return least;
}

#define HALF (LANES / 2)
typedef double wide __attribute__((vector_size(8 * HALF)));
typedef float half __attribute__((vector_size(4 * HALF), aligned(4)));

/* Integrals of the weight above the pedestal and of its first moment, up to the upper edge of every
 * lag that is known. */
INLINE void integrate(const Group *group, vec pedestal)
{
    wide mass[2] = {0}, moment[2] = {0};
    for (int lag = group->low - 1; lag < group->high; lag++) {
        float weight[LANES];
        vec above = group->correlation[lag] - pedestal;
        store(weight, choose((above > 0.0f) & (lag >= group->low ? -1 : 0), above, (vec){0}));
        for (int i = 0; i < 2; i++) {
            wide w = __builtin_convertvector(*(const half *)(weight + i * HALF), wide);
            mass[i] += w;
            moment[i] += w * (double)lag;
            ((wide *)(group->mass + lag * LANES))[i] = mass[i];
            ((wide *)(group->moment + lag * LANES))[i] = moment[i];
        }
    }
}

INLINE double clipped(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* A pixel's integral between two places; `first` and `last` are the lags that hold them. */
INLINE double between(const double *table, double from, int first, double to, int last)
{
    double a = table[(first - 1) * LANES], b = table[(last - 1) * LANES];
    return b - a + (table[last * LANES] - b) * (to + 0.5 - last)
         - (table[first * LANES] - a) * (from + 0.5 - first);
}

/* Delays in bins: from the highest lag to the centroid of a window that follows it. */
APART void follow(const Paper *paper, Group *group, vec pedestal, double *delay)
{
    double from[LANES], to[LANES], edge = paper->most + 0.5;
    int first[LANES], last[LANES], some = paper->most + 1;
    for (int round = 0; round < CENTROID_ROUNDS; round++) {
        int low = some, high = -some;
        for (int lane = 0; lane < LANES; lane++) {
            from[lane] = clipped(delay[lane] - paper->half_width, -edge, edge);
            to[lane] = clipped(delay[lane] + paper->half_width, -edge, edge);
            first[lane] = (int)(from[lane] + 0.5 + some) - some;
            last[lane] = (int)(to[lane] + 0.5 + some) - some;
            low = first[lane] < low ? first[lane] : low;
            high = last[lane] > high ? last[lane] : high;
        }
        if (extend(paper, group, low, high + 1) || !round)
            integrate(group, pedestal);
        for (int lane = 0; lane < LANES; lane++) {
            double a = from[lane], b = to[lane];
            double inside = between(group->mass + lane, a, first[lane], b, last[lane]);
            double moment = between(group->moment + lane, a, first[lane], b, last[lane]);
            if (inside > 0)
                delay[lane] = moment / inside;
            delay[lane] = clipped(delay[lane], -paper->search, paper->search);
        }
    }
}

/* Running sums of references that are moved by whole bins. */
APART void shift_references(const Paper *paper, Group *group, const int32_t *whole)
{
    int count = paper->bins + 2 * paper->reach;
    const char *row[LANES];
    for (int lane = 0; lane < LANES; lane++)
        row[lane] = group->reference[lane] - 2 * (whole[lane] + paper->reach);
    ivec pairs[LANES], before = {0};
    vec *to = group->shifted - paper->reach;
    for (int at = 0; at < count; at += 2 * LANES, to += 2 * LANES) {
        transposed_pairs(&REFERENCES, row, at, count, pairs);
        before = transposed_running_sums(pairs, before, to);
    }
    *to = __builtin_convertvector(before, vec);
}

/* Σ m·h(i + m) over ±reach of counts h whose running sums are these before bin i, which is
 * reach·(left + right) − between. */
typedef struct {
    const vec *running; /* or whole numbers */
    vec here, left, right, between;
} Slope;

INLINE vec sum_before(const vec *running, ptrdiff_t bin, int whole)
{
    return whole ? __builtin_convertvector((ivec)running[bin], vec) : running[bin];
}

INLINE Slope slope_at(const vec *running, int reach, int whole)
{
    Slope slope = {running, sum_before(running, 0, whole), sum_before(running, -reach, whole),
                   sum_before(running, reach + 1, whole), {0}};
    for (int m = 1 - reach; m <= reach; m++)
        slope.between += sum_before(running, m, whole);
    return slope;
}

/* Square of the slope. */
INLINE vec squared(const Slope *s, int reach)
{
    vec slope = (float)reach * (s->left + s->right) - s->between;
    return slope * slope;
}

/* Goes on to the next bin, by what enters and leaves; returns the bin's counts. */
INLINE vec advance(Slope *s, ptrdiff_t reach, int whole)
{
    vec next = sum_before(s->running, 1, whole), counts = next - s->here;
    s->left = sum_before(s->running, 1 - reach, whole);
    s->between += s->right - s->left;
    s->right = sum_before(s->running, reach + 2, whole);
    s->here = next;
    s->running++;
    return counts;
}

/* Variance of the centroid but for its gain: each photon of light moves it by the reference's
 * slope, each of the reference by the light's; see `_centroid_deviation` of paper.py. `whole` tells
 * whether running sums of light are whole numbers. */
INLINE vec scatter_of(const Paper *paper, Group *group, int whole)
{
    int reach = paper->reach;
    Slope light = slope_at((const vec *)group->running, reach, whole);
    Slope reference = slope_at(group->shifted, reach, 0);
    vec by_light = {0}, by_reference = {0};
    for (int i = 0; i < paper->bins; i++) {
        if (i % (16 / LANES) == 0)
            fetch_next(group);
        vec moves = squared(&reference, reach), moved = squared(&light, reach);
        by_light += moves * advance(&light, reach, whole);
        by_reference += moved * advance(&reference, reach, 0);
    }
    return by_light + by_reference;
}

APART vec scatter(const Paper *paper, Group *group)
{
    return group->step == 1 ? scatter_of(paper, group, 1) : scatter_of(paper, group, 0);
}

/* How much less than its mass the peak moves the centroid, as its window follows. */
APART void gains(const Paper *paper, Group *group, vec pedestal, const int32_t *whole,
                  double *gain)
{
    int reach = paper->reach, low = paper->most, high = -paper->most;
    ivec middle;
    for (int lane = 0; lane < LANES; lane++) {
        middle[lane] = whole[lane];
        low = whole[lane] < low ? whole[lane] : low;
        high = whole[lane] > high ? whole[lane] : high;
    }
    low -= reach, high += reach;
    extend(paper, group, low, high + 1);
    vec inside = {0}, edges = {0};
    for (int lag = low; lag <= high; lag++) {
        vec above = group->correlation[lag] - pedestal;
        ivec before = lag < middle - reach, after = lag > middle + reach;
        ivec edge = (lag == middle - reach) | (lag == middle + reach);
        inside += choose(before | after, (vec){0}, above);
        edges += choose(edge, above, (vec){0});
    }
    for (int lane = 0; lane < LANES; lane++) {
        double edge = edges[lane];
        gain[lane] = (double)inside[lane] - paper->half_width * (edge > 0 ? edge : 0);
    }
}

/* A pixel's counts before a bin of the sensor. */
INLINE int64_t whole_before(const Group *group, int lane, int bin)
{
    const int32_t *running = (const int32_t *)(group->running + bin) + lane;
    return group->step == 1 ? *running : (int64_t)*(const float *)running;
}

/* A pixel's counts before a bin that may lie on another turn. */
INLINE int64_t before(const Paper *paper, const Group *group, int lane, int bin)
{
    int bins = paper->bins;
    if (!paper->circular)
        bin = bin < 0 ? 0 : bin > bins ? bins : bin;
    int64_t turns = 0;
    for (; bin < 0; bin += bins)
        turns--;
    for (; bin > bins; bin -= bins)
        turns++;
    return whole_before(group, lane, bin) + turns * whole_before(group, lane, bins);
}

/* A pixel's counts from one bin up to another, either of which may lie on another turn. */
INLINE double counts_in(const Paper *paper, const Group *group, int lane, int start, int stop)
{
    if (start >= 0 && stop <= paper->bins) { /* most windows; differences are exact */
        const ivec *first = group->running + start, *last = group->running + stop;
        return group->step == 1 ? (double)((*last)[lane] - (*first)[lane])
                                : (double)((*(const vec *)last)[lane] - (*(const vec *)first)[lane]);
    }
    return (double)(before(paper, group, lane, stop) - before(paper, group, lane, start));
}

/* A pixel's counts in the bands' windows, moved by `shift` bins. */
INLINE void sum_windows(const Paper *paper, const Group *group, int lane, int shift, double *sums)
{
    for (int k = 0; k < paper->bands; k++)
        sums[k] = 0;
    for (int w = 0; w < paper->windows; w++) {
        const int32_t *window = paper->window + (size_t)w * 3;
        sums[window[0]] += counts_in(paper, group, lane, window[1] + shift, window[2] + shift);
    }
}

/* A pixel's counts per bin in no window. */
INLINE double background(const Paper *paper, const Group *group, int lane)
{
    int64_t apart = 0;
    for (int g = 0; g < paper->gaps; g++)
        apart += whole_before(group, lane, paper->gap[2 * g + 1])
               - whole_before(group, lane, paper->gap[2 * g]);
    return paper->outside ? (double)apart / paper->outside : NAN;
}

/* Pixels of `which` from `at` on, LANES at most. */
INLINE void correlate_group(const Paper *paper, Group *group, const Light *light,
                            const int64_t *which, size_t at, size_t end,
                            const PaperResults *results)
{
    const int64_t *pixel = which + at;
    int count = end - at < LANES ? (int)(end - at) : LANES;
    double delay[LANES], gain[LANES];
    int32_t whole[LANES];
    find_rows(paper, group, light, which, at, end);
    prepare_group(paper, group, light);
    extend(paper, group, -paper->search, paper->search + 1);
    vec pedestal = search_peak(paper, group, delay);
    follow(paper, group, pedestal, delay);
    for (int lane = 0; lane < LANES; lane++)
        whole[lane] = (int32_t)rint(delay[lane]);
    gains(paper, group, pedestal, whole, gain);
    shift_references(paper, group, whole);
    vec variance = scatter(paper, group);
    for (int lane = 0; lane < count; lane++) {
        size_t place = at + (size_t)lane;
        results->delay[place] = delay[lane];
        results->deviation[place] = gain[lane] > 0 ? sqrt((double)variance[lane]) / gain[lane]
                                                   : INFINITY;
        results->background[place] = background(paper, group, lane);
        sum_windows(paper, group, lane,
                    (int)rint(delay[lane] + paper->pixel_delays[pixel[lane]]),
                    results->sums + place * (size_t)paper->bands);
    }
}

/* Scratch memory of a group, laid out from `block` on; returns how much, also without a block. */
static size_t lay_out(const Paper *paper, char *block, Group *group)
{
    size_t bins = (size_t)paper->bins + 2 * LANES, lags = (size_t)paper->most + LAGS + 2;
    size_t reach = (size_t)paper->reach + 2;
    size_t sizes[] = {bins + 2 * reach, bins + 2 * reach, bins, bins + 2 * lags,
                      2 * lags + 1, 4 * lags + 2, 4 * lags + 2};
    size_t origins[] = {reach, reach, 0, lags, lags, 2 * lags, 2 * lags};
    void *parts[sizeof sizes / sizeof *sizes];
    size_t used = 0;
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        parts[i] = block ? block + (used + origins[i]) * sizeof(vec) : NULL;
        used += sizes[i];
    }
    *group = (Group){.running = parts[0], .shifted = parts[1], .first = parts[2],
                     .second = parts[3], .correlation = parts[4], .mass = parts[5],
                     .moment = parts[6]};
    return used * sizeof(vec);
}
