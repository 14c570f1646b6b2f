/* Sixteen floats at a time, in the compiler's own vector types: one AVX-512 register, two of AVX,
 * four of SSE. Everything is inlined into functions that are compiled once for each of these. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define LANES 16
#define INLINE static inline __attribute__((always_inline))

typedef float vec __attribute__((vector_size(64)));
typedef float loose __attribute__((vector_size(64), aligned(4)));  /* wherever it lies */
typedef int32_t ivec __attribute__((vector_size(64)));

INLINE vec load(const float *from) { return *(const loose *)from; }
INLINE void store(float *to, vec x) { *(loose *)to = x; }
INLINE vec fill(float x) { return x - (vec){0}; }
INLINE vec choose(ivec mask, vec yes, vec no)
{
    return (vec)((mask & (ivec)yes) | (~mask & (ivec)no));
}
INLINE vec greater(vec a, vec b) { return choose(a > b, a, b); }

INLINE float sum(vec x)
{
    typedef float half __attribute__((vector_size(32)));
    typedef float quarter __attribute__((vector_size(16)));
    half low, high;
    memcpy(&low, &x, 32);
    memcpy(&high, (const char *)&x + 32, 32);
    low += high;
    quarter a, b;
    memcpy(&a, &low, 16);
    memcpy(&b, (const char *)&low + 16, 16);
    a += b;
    return (a[0] + a[1]) + (a[2] + a[3]);
}

INLINE vec root(vec x)
{
    vec y = {0};
    for (int lane = 0; lane < LANES; lane++)
        y[lane] = sqrtf(x[lane]);
    return y;
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
