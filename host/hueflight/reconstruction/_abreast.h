/* Pixels side by side, one in each lane: a vector holds the same bin of LANES pixels, so that sums
 * over bins and shifts between them need nothing from other lanes. */
#ifdef __SSE2__
#include <immintrin.h>
#endif

typedef uint32_t uvec __attribute__((vector_size(4 * LANES)));
typedef int32_t loose_ints __attribute__((vector_size(4 * LANES), aligned(2), may_alias));
typedef uint16_t half_lane __attribute__((may_alias));

/* Lanes of two vectors, those of the second counted from LANES on. */
INLINE ivec joined(ivec a, ivec b, ivec from)
{
#ifdef __clang__
    ivec y = {0};
    for (int lane = 0; lane < LANES; lane++)
        y[lane] = from[lane] < LANES ? a[from[lane]] : b[from[lane] - LANES];
    return y;
#else
    return (ivec)__builtin_shuffle((vec)a, (vec)b, from);
#endif
}

/* Of every `ways` pieces of `size` lanes: the even ones (or the odd) of the first vector, then those
 * of the second. */
INLINE ivec dealt(ivec a, ivec b, int size, int ways, int odd)
{
    ivec lanes = lane_numbers(), piece = lanes / size % ways * 2;
    ivec from = lanes - lanes % (size * ways) + (piece % ways + odd) * size + lanes % size;
    return joined(a, b, from + piece / ways * LANES);
}

/* Rows become columns: single lanes within fours, then fours; processors shuffle these fastest. */
INLINE void transpose(ivec *x)
{
#pragma GCC unroll 2
    for (int size = 1; size < LANES; size *= 4) {
        const int ways = LANES / size < 4 ? LANES / size : 4;
#pragma GCC unroll 2
        for (int pass = 1; pass < ways; pass *= 2) {
            ivec y[LANES];
#pragma GCC unroll 16
            for (int i = 0; i < LANES; i++) {
                int digit = i / size % ways, first = i - digit * size, half = ways / 2;
                int from = first + digit % half * 2 * size;
                y[i] = dealt(x[from], x[from + size], size, ways, digit / half);
            }
#pragma GCC unroll 16
            for (int i = 0; i < LANES; i++)
                x[i] = y[i];
        }
    }
}

/* Of pairs of 16 bits in the order of memory: one, the other, and the pair between two pairs. */
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
INLINE ivec first_of(ivec pair) { return (ivec)((uvec)pair >> 16); }
INLINE ivec second_of(ivec pair) { return pair & 0xffff; }
INLINE ivec across(ivec pair, ivec next) { return pair << 16 | first_of(next); }
#else
INLINE ivec first_of(ivec pair) { return pair & 0xffff; }
INLINE ivec second_of(ivec pair) { return (ivec)((uvec)pair >> 16); }
INLINE ivec across(ivec pair, ivec next) { return second_of(pair) | next << 16; }
#endif

/* 2·LANES counts of 16 bits from each place, or the `some` that there are, as pairs in time order;
 * with `back`, time runs down memory. Zeros follow the end. */
INLINE void read_pairs(const char *const *from, int some, int back, ivec *pairs)
{
    ivec x[LANES];
#pragma GCC unroll 16
    for (int lane = 0; lane < LANES; lane++)
        if (some == 2 * LANES)
            x[lane] = (ivec)*(const loose_ints *)from[lane];
        else {
            x[lane] = (ivec){0};
            memcpy((half_lane *)&x[lane] + (back ? 2 * LANES - some : 0), from[lane],
                   2 * (size_t)some);
        }
    transpose(x);
#pragma GCC unroll 16
    for (int i = 0; i < LANES; i++)
        pairs[i] = back ? across(x[LANES - 1 - i], x[LANES - 1 - i]) : x[i];
}

#define EACH_COUNT(TYPE, WHAT)                                                                    \
    for (int lane = 0; lane < LANES; lane++)                                                      \
        for (int i = 0; i < some; i++) {                                                          \
            TYPE count = *(const TYPE *)(row[lane] + (at + i) * light->bin_step);                 \
            WHAT;                                                                                 \
        }

/* 2·LANES counts of each pixel from bin `at` on, or those up to `end` and zeros, as pairs of 16
 * bits; `row` are the pixels' first bins. Returns the bits that some pair has. */
INLINE ivec pairs_abreast(const Light *light, const char *const *row, int at, int end, ivec *pairs)
{
    int some = end - at < 2 * LANES ? end - at : 2 * LANES, back = light->bin_step < 0;
    ivec seen = {0};
    if (light->type != 'H' || (light->bin_step != 2 && light->bin_step != -2)) {
        memset(pairs, 0, LANES * sizeof *pairs);
        if (light->type == 'H')
            EACH_COUNT(uint16_t, ((half_lane *)(pairs + i / 2))[2 * lane + i % 2] = count)
        else
            EACH_COUNT(uint32_t, ((half_lane *)(pairs + i / 2))[2 * lane + i % 2] = (uint16_t)count;
                       seen[0] |= count > 0x7fff ? -1 : 0)
    } else {
        const char *from[LANES];
        for (int lane = 0; lane < LANES; lane++)
            from[lane] = row[lane] + (back ? at + some - 1 : at) * light->bin_step;
        if (some < 2 * LANES)
            read_pairs(from, some, back, pairs);
        else if (back)
            read_pairs(from, 2 * LANES, 1, pairs);
        else
            read_pairs(from, 2 * LANES, 0, pairs);
    }
    for (int i = 0; i < LANES; i++)
        seen |= pairs[i];
    return seen;
}

/* Asks for such counts of other pixels ahead of their use; `lowest` is where their memory begins. */
INLINE void fetch_abreast(const Light *light, const char *const *lowest, int at)
{
    Py_ssize_t by = light->bin_step < 0 ? -light->bin_step : light->bin_step;
    for (int lane = 0; lane < LANES; lane++)
        __builtin_prefetch(lowest[lane] + at * by);
}

/* Sums up to each count of pairs, the count itself not included; returns the sum of all. */
INLINE ivec running_abreast(const ivec *pairs, ivec before, ivec *running)
{
    for (int i = 0; i < LANES; i++) {
        running[2 * i] = before;
        before += first_of(pairs[i]);
        running[2 * i + 1] = before;
        before += second_of(pairs[i]);
    }
    return before;
}

/* Counts as `pairs_abreast` reads them, but each of 32 bits. */
INLINE void counts_abreast(const Light *light, const char *const *row, int at, int end, ivec *counts)
{
    int some = end - at < 2 * LANES ? end - at : 2 * LANES;
    memset(counts, 0, 2 * LANES * sizeof *counts);
    if (light->type == 'H')
        EACH_COUNT(uint16_t, ((int32_t *)(counts + i))[lane] = count)
    else
        EACH_COUNT(uint32_t, ((int32_t *)(counts + i))[lane] = (int32_t)count)
}

INLINE int any(ivec mask)
{
    int32_t some = 0;
    for (int lane = 0; lane < LANES; lane++)
        some |= mask[lane];
    return some != 0;
}

/* Products of the lower and of the upper 16 bits, signed, added. */
INLINE ivec pair_products(ivec a, ivec b)
{
#if defined(__AVX512BW__) && LANES == 16
    return (ivec)_mm512_madd_epi16((__m512i)a, (__m512i)b);
#elif defined(__AVX2__) && LANES == 8
    return (ivec)_mm256_madd_epi16((__m256i)a, (__m256i)b);
#elif defined(__SSE2__) && LANES == 4
    return (ivec)_mm_madd_epi16((__m128i)a, (__m128i)b);
#else
    ivec c = (ivec)((uvec)a << 16) >> 16, d = (ivec)((uvec)b << 16) >> 16;
    return c * d + (a >> 16) * (b >> 16);
#endif
}
