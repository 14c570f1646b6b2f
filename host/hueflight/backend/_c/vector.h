/* SPDX-License-Identifier: Apache-2.0 */
/* LANES floats at a time, in the compiler's vector types. Whoever includes this says how many: as
 * many as fit a register of the processor that the build is for. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#ifdef __SSE2__
#include <immintrin.h>
#endif

#define LEAST 1e-30f /* added to expected counts, so that padding divides by something */
#define INLINE static inline __attribute__((always_inline))
#define APART static __attribute__((noinline)) /* keeps registers and code of one step together */

typedef float vec __attribute__((vector_size(4 * LANES)));
typedef float loose __attribute__((vector_size(4 * LANES), aligned(4))); /* wherever it lies */
typedef int32_t ivec __attribute__((vector_size(4 * LANES)));
typedef int64_t vec_64 __attribute__((vector_size(4 * LANES))); /* half as many lanes */

INLINE vec load(const float *from) { return *(const loose *)from; }
INLINE void store(float *to, vec x) { *(loose *)to = x; }
INLINE vec fill(float x) { return x - (vec){0}; }
INLINE vec choose(ivec mask, vec yes, vec no)
{
    return (vec)((mask & (ivec)yes) | (~mask & (ivec)no));
}

/* What processors compute in one instruction, but compilers do not see in the vector types. Estimates of
 * 12 bits or more become full ones by a step of Newton's method. */
#if defined(__AVX512F__) && LANES == 16
#define REGISTER __m512
#define DOUBLES __m512d
#define INTRINSIC(NAME) _mm512_##NAME
#define ESTIMATE(NAME) _mm512_##NAME##14_ps
#elif defined(__AVX2__) && LANES == 8
#define REGISTER __m256
#define DOUBLES __m256d
#define INTRINSIC(NAME) _mm256_##NAME
#define ESTIMATE(NAME) _mm256_##NAME##_ps
#elif defined(__SSE2__) && LANES == 4
#define REGISTER __m128
#define DOUBLES __m128d
#define INTRINSIC(NAME) _mm_##NAME
#define ESTIMATE(NAME) _mm_##NAME##_ps
#endif

#ifdef REGISTER
INLINE vec greater(vec a, vec b) { return (vec)INTRINSIC(max_ps)((REGISTER)a, (REGISTER)b); }
INLINE vec lesser(vec a, vec b) { return (vec)INTRINSIC(min_ps)((REGISTER)a, (REGISTER)b); }
INLINE vec root(vec x) { return (vec)INTRINSIC(sqrt_ps)((REGISTER)x); }

INLINE vec reciprocal(vec x)
{
    vec y = (vec)ESTIMATE(rcp)((REGISTER)x);
    return y * (2.0f - x * y);
}

INLINE vec reciprocal_root(vec x)
{
    vec y = (vec)ESTIMATE(rsqrt)((REGISTER)x);
    return y * (1.5f - 0.5f * x * y * y);
}
#else
INLINE vec greater(vec a, vec b) { return choose(a > b, a, b); }
INLINE vec lesser(vec a, vec b) { return choose(a < b, a, b); }

INLINE vec root(vec x)
{
    float y[LANES]; /* in memory: compilers see the loop, but not through a vector's elements */
    store(y, x);
    for (int lane = 0; lane < LANES; lane++)
        y[lane] = sqrtf(y[lane]);
    return load(y);
}

INLINE vec reciprocal(vec x) { return 1.0f / x; }
INLINE vec reciprocal_root(vec x) { return 1.0f / root(x); }
#endif

INLINE ivec lane_numbers(void)
{
    ivec n = {0};
    for (int lane = 0; lane < LANES; lane++)
        n[lane] = lane;
    return n;
}

/* Lanes in another order. */
#ifdef __clang__
#define PICKED(NAME, VECTOR, ORDER)                            \
    INLINE VECTOR NAME(VECTOR x, ORDER from)                   \
    {                                                          \
        VECTOR y = {0};                                        \
        for (size_t i = 0; i < sizeof x / sizeof x[0]; i++)    \
            y[i] = x[from[i]];                                 \
        return y;                                              \
    }
#else
#define PICKED(NAME, VECTOR, ORDER) \
    INLINE VECTOR NAME(VECTOR x, ORDER from) { return __builtin_shuffle(x, from); }
#endif
PICKED(picked, vec, ivec)
PICKED(picked_64, vec_64, vec_64)

INLINE vec swap(vec x, int distance) { return picked(x, lane_numbers() ^ distance); }

INLINE float sum(vec x)
{
    for (int distance = LANES / 2; distance; distance /= 2)
        x += swap(x, distance);
    return x[0];
}

/* Sums of as many vectors as there are lanes, one in each lane; the vectors are used up. */
INLINE vec sums(vec *x)
{
    for (int distance = 1; distance < LANES; distance *= 2) {
        ivec odd = (lane_numbers() & distance) != 0;
        for (int i = 0; i < LANES; i += 2 * distance) {
            vec a = x[i], b = x[i + distance];
            x[i] = choose(odd, b, a) + swap(choose(odd, a, b), distance);
        }
    }
    return x[0];
}

/* Natural logarithm of normal positive numbers, to 2 units in the last place: the mantissa within
 * √½ … √2 by the series of atanh((m − 1)/(m + 1)), the exponent apart. */
INLINE vec logarithm(vec x)
{
    ivec bits = (ivec)x;
    ivec exponent = ((bits - 0x3f3504f3) >> 23);
    vec m = (vec)(bits - (exponent << 23));
    vec e = __builtin_convertvector(exponent, vec);
    vec f = (m - 1.0f) / (m + 1.0f), s = f * f;
    vec series = 0.2f + s * (0.142857143f + s * (0.111111111f + s * 0.0909090909f));
    series = s * (0.333333333f + s * series);
    return 2.0f * f + 2.0f * f * series + e * 0.693147181f;
}

/* Places and values of what is not 0; returns how many. */
INLINE int occupied(const float *from, int count, int32_t *where, float *values)
{
    int some = 0, i = 0;
#if defined(__AVX512F__) && LANES == 16
    for (; i + LANES <= count; i += LANES) {
        __m512 h = _mm512_loadu_ps(from + i);
        __mmask16 there = _mm512_cmp_ps_mask(h, _mm512_setzero_ps(), _CMP_NEQ_OQ);
        __m512i number = _mm512_add_epi32((__m512i)lane_numbers(), _mm512_set1_epi32(i));
        _mm512_storeu_si512(where + some, _mm512_maskz_compress_epi32(there, number));
        _mm512_storeu_ps(values + some, _mm512_maskz_compress_ps(there, h));
        some += __builtin_popcount(there);
    }
#endif
    for (; i < count; i++) {
        where[some] = i;
        values[some] = from[i];
        some += from[i] != 0;
    }
    return some;
}
