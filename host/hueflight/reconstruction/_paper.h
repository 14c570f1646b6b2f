/* The paper's method on one pixel: correlation with its reference, centroid, window sums. paper.py
 * is its definition. Counts are whole numbers, so that sums of them are exact. */

/* What all pixels share. Lags are counted from −most to most. */
typedef struct {
    int bins, search, reach, most, circular, windows, bands, gaps, outside;
    double half_width;
    const int32_t *window, *gap; /* (band, start, stop) each; (start, stop) of bins in no window */
} Paper;

/* `light` begins `reach` bins early and ends as much late, around the circle; `reference` has
 * `most` zeros about it; `correlation` runs from the last lag to the first, as the reference does
 * when lags rise. */
typedef struct {
    float *light, *reference, *correlation, *counts, *steep;
    int32_t *bins, *running, *twice;
} Sheet;

#define ABREAST 3 /* vectors of lags that stay in registers */

/* Correlation at the lags of places from `place` on, `vectors` of them. */
INLINE void correlate_some(const Sheet *sheet, int some, int place, int vectors)
{
    vec even[ABREAST] = {0}, odd[ABREAST] = {0};
    const float *reference = sheet->reference + place;
    int k = 0;
    for (; k + 2 <= some; k += 2) {
        const float *here = reference + sheet->bins[k], *next = reference + sheet->bins[k + 1];
        vec a = fill(sheet->counts[k]), b = fill(sheet->counts[k + 1]);
        for (int v = 0; v < vectors; v++) {
            even[v] += a * load(here + v * LANES);
            odd[v] += b * load(next + v * LANES);
        }
    }
    if (k < some)
        for (int v = 0; v < vectors; v++)
            even[v] += fill(sheet->counts[k]) * load(reference + sheet->bins[k] + v * LANES);
    for (int v = 0; v < vectors; v++)
        store(sheet->correlation + place + v * LANES, even[v] + odd[v]);
}

/* Correlation at the lags of places [from, to) of the sheet, whole vectors of them. */
INLINE void correlate(const Sheet *sheet, int some, int from, int to)
{
    int place = from;
    for (; to - place > 2 * LANES; place += ABREAST * LANES)
        correlate_some(sheet, some, place, ABREAST);
    for (; place < to; place += LANES)
        correlate_some(sheet, some, place, 1);
}

/* Sums of a vector up to each lane, the lane itself included. */
INLINE ivec up_to_lane(ivec x)
{
#if defined(__AVX512F__) && LANES == 16
    __m512i y = (__m512i)x, nothing = _mm512_setzero_si512();
    y = _mm512_add_epi32(y, _mm512_alignr_epi32(y, nothing, 15));
    y = _mm512_add_epi32(y, _mm512_alignr_epi32(y, nothing, 14));
    y = _mm512_add_epi32(y, _mm512_alignr_epi32(y, nothing, 12));
    y = _mm512_add_epi32(y, _mm512_alignr_epi32(y, nothing, 8));
    return (ivec)y;
#endif
    ivec lanes = lane_numbers();
    for (int by = 1; by < LANES; by *= 2)
        x += (lanes >= by) & (ivec)picked((vec)x, (lanes - by) & (LANES - 1));
    return x;
}

/* Sums up to each place, the place itself included, and sums of those, modulo 2³². */
INLINE void sum_up(const float *from, int count, int32_t *once, int32_t *twice)
{
    ivec last = (ivec){0} + (LANES - 1), before = {0}, before_twice = {0};
    for (int i = 0; i < count; i += LANES) {
        ivec x = up_to_lane(__builtin_convertvector(load(from + i), ivec));
        ivec y = up_to_lane(x + before) + before_twice;
        store((float *)once + i, (vec)(x + before));
        store((float *)twice + i, (vec)y);
        before += (ivec)picked((vec)x, last);
        before_twice = (ivec)picked((vec)y, last);
    }
}

/* Σ a·b² of `count` numbers, by lanes. */
INLINE vec weighed(const float *a, const float *b, int count)
{
    vec even = {0}, odd = {0};
    int i = 0;
    for (; i + 2 * LANES <= count; i += 2 * LANES) {
        vec x = load(b + i), y = load(b + i + LANES);
        even += load(a + i) * x * x;
        odd += load(a + i + LANES) * y * y;
    }
    for (; i < count; i += LANES) {
        ivec inside = lane_numbers() < count - i;
        vec x = choose(inside, load(b + i), (vec){0});
        even += choose(inside, load(a + i), (vec){0}) * x * x;
    }
    return even + odd;
}

#define HALF (LANES / 2)
typedef double wide __attribute__((vector_size(8 * HALF)));
typedef int64_t wide_mask __attribute__((vector_size(8 * HALF)));
typedef float half __attribute__((vector_size(4 * HALF), aligned(4)));

/* Clipped to 0 … 1. */
INLINE wide share(wide x)
{
    wide_mask above = x > 0.0, below = x < 1.0;
    wide one = x * 0.0 + 1.0;
    return (wide)(above & ((below & (wide_mask)x) | (~below & (wide_mask)one)));
}

INLINE double total(wide x)
{
    double whole = 0;
    for (int lane = 0; lane < HALF; lane++)
        whole += x[lane];
    return whole;
}

/* Integral of the weight above the pedestal between two edges of lags, and of its first moment.
 * Edges count from the first lag. */
INLINE void integrate(const Paper *paper, const Sheet *sheet, float pedestal, double from, double to,
                      double *mass, double *moment)
{
    int last = 2 * paper->most, place = last + 1 - (int)ceil(to);
    wide inside = {0}, first = {0};
    wide lag;
    for (int lane = 0; lane < HALF; lane++)
        lag[lane] = last - place - lane;
    for (; place <= last - (int)from; place += HALF, lag -= HALF) {
        wide above = __builtin_convertvector(*(const half *)(sheet->correlation + place), wide);
        above -= (double)pedestal;
        wide weight = (wide)((above > 0.0) & (wide_mask)above);
        weight *= share(to - lag) - share(from - lag);
        inside += weight;
        first += weight * (lag - (double)paper->most);
    }
    *mass = total(inside);
    *moment = total(first);
}

INLINE double clipped(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* Delay in bins; `low` and `high`, the lags known as yet, grow where more are wanted. */
INLINE double centroid(const Paper *paper, const Sheet *sheet, int some, float *pedestal,
                       int *low, int *high)
{
    int most = paper->most, first = most - paper->search, last = most + paper->search;
    vec smallest = fill(INFINITY), greatest = fill(-INFINITY);
    for (int j = first; j <= last; j += LANES) {
        ivec inside = lane_numbers() <= last - j;
        vec c = load(sheet->correlation + j);
        greatest = greater(greatest, choose(inside, c, fill(-INFINITY)));
        smallest = -greater(-smallest, choose(inside, -c, fill(-INFINITY)));
    }
    for (int distance = LANES / 2; distance; distance /= 2) {
        greatest = greater(greatest, swap(greatest, distance));
        smallest = -greater(-smallest, -swap(smallest, distance));
    }
    float least = smallest[0], top = greatest[0];
    int best = last; /* lags rise as places fall */
    while (sheet->correlation[best] < top)
        best--;
    *pedestal = least;
    double delay = most - best, edge = most + 0.5;
    for (int round = 0; round < 3; round++) {
        double from = clipped(delay - paper->half_width, -edge, edge) + edge;
        double to = clipped(delay + paper->half_width, -edge, edge) + edge;
        if (from < *low || to > *high) {
            correlate(sheet, some, 0, 2 * most + 1 - *high);
            correlate(sheet, some, 2 * most + 1 - *low, 2 * most + 1);
            *low = 0, *high = 2 * most + 1;
        }
        double inside, first;
        integrate(paper, sheet, least, from, to, &inside, &first);
        if (inside > 0)
            delay = first / inside;
        delay = clipped(delay, -paper->search, paper->search);
    }
    return delay;
}

/* Standard deviation of the centroid; see `_centroid_deviation` of paper.py. */
INLINE double deviation_of(const Paper *paper, const Sheet *sheet, const float *influence,
                           int whole, float pedestal)
{
    int bins = paper->bins, reach = paper->reach, at = (whole % bins + bins) % bins;
    const float *light = sheet->light + reach, *reference = sheet->reference + paper->most;
    /* Σ m·h(i + m) over ±reach, by parts */
    for (int i = 0; i < bins; i += LANES) {
        ivec ends = (ivec)load((float *)sheet->running + i)
                  + (ivec)load((float *)sheet->running + i + 2 * reach + 1);
        ivec slope = reach * ends - (ivec)load((float *)sheet->twice + i + 2 * reach + 1)
                   + (ivec)load((float *)sheet->twice + i + 1);
        store(sheet->steep + i, __builtin_convertvector(slope, vec));
    }
    float scatter = sum(weighed(light + at, influence, bins - at)
                        + weighed(light, influence + bins - at, at)
                        + weighed(reference, sheet->steep + at, bins - at)
                        + weighed(reference + bins - at, sheet->steep, at));
    const float *middle = sheet->correlation + paper->most - whole;
    double inside = 0, edge = 0.5 * ((double)middle[-reach] + (double)middle[reach]) - (double)pedestal;
    double odd = 0; /* two sums, so that one addition need not wait for the other */
    for (int lag = -reach; lag < reach; lag += 2) {
        inside += (double)middle[lag];
        odd += (double)middle[lag + 1];
    }
    inside += odd + (double)middle[reach];
    double gain = inside - (2 * reach + 1) * (double)pedestal
                - 2 * paper->half_width * (edge > 0 ? edge : 0);
    return gain > 0 ? sqrt((double)scatter) / gain : INFINITY;
}

/* Counts before a bin that may lie on another turn. */
INLINE double before(const Paper *paper, const int32_t *running, int bin)
{
    int bins = paper->bins;
    if (!paper->circular)
        return running[bin < 0 ? 0 : bin > bins ? bins : bin] - running[0];
    int turns = bin / bins - (bin % bins < 0), rest = bin - turns * bins;
    return (double)(running[rest] - running[0])
         + (double)turns * (double)(running[bins] - running[0]);
}

/* One pixel whose light is on the sheet; `influence` is the reference's, see paper_compiled.py. */
INLINE void correlate_pixel(const Paper *paper, const Sheet *sheet, const uint16_t *reference,
                            const float *influence, double pixel_delay, double *delay,
                            double *deviation, double *sums, double *background)
{
    int bins = paper->bins, reach = paper->reach, most = paper->most;
    memcpy(sheet->light, sheet->light + bins, (size_t)reach * sizeof(float));
    memcpy(sheet->light + bins + reach, sheet->light + reach, (size_t)reach * sizeof(float));
    widen(reference, bins, sheet->reference + most);
    int some = occupied(sheet->light + reach, bins, sheet->bins, sheet->counts);
    sum_up(sheet->light, bins + 2 * reach, sheet->running + 1, sheet->twice + 2);
    int low = most - paper->search, high = most + paper->search + 1;
    correlate(sheet, some, low, high);
    float pedestal;
    *delay = centroid(paper, sheet, some, &pedestal, &low, &high);
    int whole = (int)rint(*delay);
    if (most + whole - reach < low || most + whole + reach >= high) {
        correlate(sheet, some, 0, most - paper->search);
        correlate(sheet, some, most + paper->search + 1, 2 * most + 1);
    }
    *deviation = deviation_of(paper, sheet, influence, whole, pedestal);
    const int32_t *running = sheet->running + reach;
    int shift = (int)rint(*delay + pixel_delay);
    for (int k = 0; k < paper->bands; k++)
        sums[k] = 0;
    for (int w = 0; w < paper->windows; w++) {
        const int32_t *window = paper->window + (size_t)w * 3;
        sums[window[0]] += before(paper, running, window[2] + shift)
                         - before(paper, running, window[1] + shift);
    }
    double apart = 0;
    for (int g = 0; g < paper->gaps; g++)
        apart += running[paper->gap[2 * g + 1]] - running[paper->gap[2 * g]];
    *background = paper->outside ? apart / paper->outside : NAN;
}

static size_t sheet_bytes(const Paper *paper)
{
    return 10 * 4 * (size_t)(paper->bins + 2 * paper->most + 2 * paper->reach + 8 * LANES) + 64 * 12;
}

static void lay_out(const Paper *paper, char *place, Sheet *sheet)
{
    size_t room = 4 * (size_t)(paper->bins + 2 * paper->most + 2 * paper->reach + 8 * LANES);
    char **parts[] = {(char **)&sheet->light, (char **)&sheet->reference,
                      (char **)&sheet->correlation, (char **)&sheet->counts, (char **)&sheet->steep,
                      (char **)&sheet->bins, (char **)&sheet->running, (char **)&sheet->twice};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++, place += (room + 63) / 64 * 64)
        *parts[i] = place;
}
