/* SPDX-License-Identifier: Apache-2.0 */
/* Transposes counts, so that a vector holds the same bin of LANES pixels, one in each lane: sums over
 * bins and shifts between them then need nothing from other lanes. */
#ifdef __SSE2__
#include <immintrin.h>
#endif

typedef uint32_t uvec __attribute__((vector_size(4 * LANES)));
typedef int32_t loose_ints __attribute__((vector_size(4 * LANES), aligned(2), may_alias));

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

INLINE void transpose_floats(vec *x)
{
    ivec bits[LANES];
#pragma GCC unroll 16
    for (int i = 0; i < LANES; i++)
        bits[i] = (ivec)x[i];
    transpose(bits);
#pragma GCC unroll 16
    for (int i = 0; i < LANES; i++)
        x[i] = (vec)bits[i];
}

/* Of pairs of 16 bits in the order of memory: one, the other, and the pair between two pairs. */
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
INLINE ivec first_of(ivec pair) { return (ivec)((uvec)pair >> 16); }
INLINE ivec second_of(ivec pair) { return pair & 0xffff; }
INLINE ivec across(ivec pair, ivec next) { return pair << 16 | first_of(next); }
INLINE ivec paired(ivec first, ivec second) { return first << 16 | second; }
#else
INLINE ivec first_of(ivec pair) { return pair & 0xffff; }
INLINE ivec second_of(ivec pair) { return (ivec)((uvec)pair >> 16); }
INLINE ivec across(ivec pair, ivec next) { return second_of(pair) | next << 16; }
INLINE ivec paired(ivec first, ivec second) { return first | second << 16; }
#endif

/* LANES words of 32 bits from each place, or the `bytes` that there are and zeros; with `back`, the
 * last first. */
INLINE void read_words(const char *const *from, int bytes, int back, ivec *words)
{
    ivec x[LANES];
#pragma GCC unroll 16
    for (int lane = 0; lane < LANES; lane++)
        if (bytes == 4 * LANES)
            x[lane] = (ivec)*(const loose_ints *)from[lane];
        else {
            x[lane] = (ivec){0};
            memcpy((char *)&x[lane] + (back ? 4 * LANES - bytes : 0), from[lane], (size_t)bytes);
        }
    transpose(x);
#pragma GCC unroll 16
    for (int i = 0; i < LANES; i++)
        words[i] = x[back ? LANES - 1 - i : i];
}

/* The words in which counts of each pixel lie next to one another, in time order: those from bin
 * `at` on, as far as they come before `end`. `row` are the pixels' first bins. */
INLINE void transposed_words(const Light *light, const char *const *row, int at, int end,
                             ivec *words)
{
    int back = light->bin_step < 0, size = (int)(back ? -light->bin_step : light->bin_step);
    int some = end - at < 4 * LANES / size ? end - at : 4 * LANES / size;
    const char *from[LANES];
    for (int lane = 0; lane < LANES; lane++)
        from[lane] = row[lane] + (back ? at + some - 1 : at) * light->bin_step;
    if (some <= 0)
        memset(words, 0, LANES * sizeof *words);
    else if (some * size < 4 * LANES)
        read_words(from, some * size, back, words);
    else if (back)
        read_words(from, 4 * LANES, 1, words);
    else
        read_words(from, 4 * LANES, 0, words);
}

#define EACH_COUNT(TYPE)                                                                          \
    for (int lane = 0; lane < LANES; lane++)                                                      \
        for (int i = 0; i < 2 * LANES && at + i < end; i++)                                       \
            ((int32_t *)(counts + i))[lane]                                                       \
                = (int32_t)*(const TYPE *)(row[lane] + (at + i) * light->bin_step);

/* 2·LANES counts of each pixel from bin `at` on, or those before `end` and zeros. */
INLINE void transposed_counts(const Light *light, const char *const *row, int at, int end,
                              ivec *counts)
{
    if (is_dense(light) && light->type == 'H') {
        ivec words[LANES];
        transposed_words(light, row, at, end, words);
        for (int i = 0; i < LANES; i++) {
            ivec first = first_of(words[i]), second = second_of(words[i]);
            counts[2 * i] = light->bin_step < 0 ? second : first;
            counts[2 * i + 1] = light->bin_step < 0 ? first : second;
        }
    } else if (is_dense(light)) {
        transposed_words(light, row, at, end, counts);
        transposed_words(light, row, at + LANES, end, counts + LANES);
    } else {
        memset(counts, 0, 2 * LANES * sizeof *counts);
        if (light->type == 'H')
            EACH_COUNT(uint16_t)
        else
            EACH_COUNT(uint32_t)
    }
}

/* The same as pairs of 16 bits. Returns the bits that some count has, two counts a word. */
INLINE ivec transposed_pairs(const Light *light, const char *const *row, int at, int end,
                             ivec *pairs)
{
    ivec seen = {0};
    if (is_dense(light) && light->type == 'H') {
        transposed_words(light, row, at, end, pairs);
        for (int i = 0; i < LANES; i++) {
            pairs[i] = light->bin_step < 0 ? across(pairs[i], pairs[i]) : pairs[i];
            seen |= pairs[i];
        }
    } else {
        ivec counts[2 * LANES];
        transposed_counts(light, row, at, end, counts);
        for (int i = 0; i < LANES; i++) {
            pairs[i] = paired(counts[2 * i], counts[2 * i + 1]);
            seen |= pairs[i] | (((counts[2 * i] | counts[2 * i + 1]) & ~0x7fff) != 0);
        }
    }
    return seen;
}

/* Sums up to each count of pairs, the count itself not included; returns the sum of all. */
INLINE ivec transposed_running_sums(const ivec *pairs, ivec before, vec *running)
{
    for (int i = 0; i < LANES; i++) {
        running[2 * i] = __builtin_convertvector(before, vec);
        before += first_of(pairs[i]);
        running[2 * i + 1] = __builtin_convertvector(before, vec);
        before += second_of(pairs[i]);
    }
    return before;
}

/* Bits that some lane has. */
INLINE int32_t any(ivec mask)
{
    int32_t some = 0;
    for (int lane = 0; lane < LANES; lane++)
        some |= mask[lane];
    return some;
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

/* Adds to two sums of 16 bits each the products of bytes, of two lower and of two upper ones: without
 * sign those of `a`, with a sign those of `b`. */
#if defined(__AVX512BW__) && LANES == 16
#define BYTE_PRODUCTS 1
INLINE ivec add_byte_products(ivec sums, ivec a, ivec b)
{
    return (ivec)_mm512_add_epi16((__m512i)sums, _mm512_maddubs_epi16((__m512i)a, (__m512i)b));
}
#elif defined(__AVX2__) && LANES == 8
#define BYTE_PRODUCTS 1
INLINE ivec add_byte_products(ivec sums, ivec a, ivec b)
{
    return (ivec)_mm256_add_epi16((__m256i)sums, _mm256_maddubs_epi16((__m256i)a, (__m256i)b));
}
#else
#define BYTE_PRODUCTS 0 /* they are not used */
INLINE ivec add_byte_products(ivec sums, ivec a, ivec b) { return sums + a + b; }
#endif
