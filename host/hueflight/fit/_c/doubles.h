/* SPDX-License-Identifier: Apache-2.0 */
/* Doubles, half as many as there are lanes at a time. Logarithms and exponentials are right to a few
 * units in the last place. */

enum { ABREAST = LANES / 2 };

typedef double vec_d __attribute__((vector_size(4 * LANES)));
typedef double loose_d __attribute__((vector_size(4 * LANES), aligned(8))); /* wherever it lies */

INLINE vec_d load_d(const double *from) { return *(const loose_d *)from; }
INLINE void store_d(double *to, vec_d x) { *(loose_d *)to = x; }
INLINE vec_d fill_d(double x) { return x - (vec_d){0}; }
INLINE vec_d choose_d(vec_64 mask, vec_d yes, vec_d no)
{
    return (vec_d)((mask & (vec_64)yes) | (~mask & (vec_64)no));
}
INLINE vec_d lesser_d(vec_d a, vec_d b) { return choose_d(a < b, a, b); }
INLINE vec_d greater_d(vec_d a, vec_d b) { return choose_d(a > b, a, b); }

INLINE vec_d root_d(vec_d x)
{
#ifdef REGISTER
    return (vec_d)INTRINSIC(sqrt_pd)((DOUBLES)x);
#else
    double y[ABREAST];
    store_d(y, x);
    for (int i = 0; i < ABREAST; i++)
        y[i] = sqrt(y[i]);
    return load_d(y);
#endif
}

#define TO_WHOLE 0x1.8p52 /* added to a number, leaves its whole part in the lowest bits */

/* Natural logarithm of normal positive numbers: the mantissa within √½ … √2 by the series of
 * atanh((m − 1)/(m + 1)), the exponent apart. */
INLINE vec_d logarithm_d(vec_d x)
{
    vec_64 bits = (vec_64)x, above = (bits - 0x3fe6a09e667f3bcc) >> 52;
    vec_d m = (vec_d)(bits - (above << 52));
    vec_d e = (vec_d)(above + (vec_64)fill_d(TO_WHOLE)) - TO_WHOLE;
    vec_d f = (m - 1) / (m + 1), s = f * f, series = fill_d(1.0 / 23);
    for (int odd = 21; odd >= 3; odd -= 2)
        series = 1.0 / odd + s * series;
    return e * 0x1.62e42fee00000p-1 + (e * 0x1.a39ef35793c76p-33 + 2 * f * s * series + 2 * f);
}

/* −ln(1 − x): infinite from x = 1, NaN beyond. */
INLINE vec_d lost_logarithm(vec_d x)
{
    vec_d left = 1 - x, exact = 1 - left; /* whose difference from x is what rounding took */
    vec_d log = choose_d(exact == 0, x, -logarithm_d(left) * (x / exact));
    return choose_d(left > 0, log, choose_d(left == 0, fill_d(INFINITY), fill_d(NAN)));
}

/* e^x of numbers from −1400 to 700. */
INLINE vec_d exponential_d(vec_d x)
{
    vec_d shifted = x * 0x1.71547652b82fep0 + TO_WHOLE, n = shifted - TO_WHOLE;
    vec_d r = x - n * 0x1.62e42fee00000p-1 - n * 0x1.a39ef35793c76p-33, series = fill_d(1);
    for (int i = 13; i > 0; i--)
        series = 1 + r * (1.0 / i) * series;
    vec_64 whole = (vec_64)shifted - (vec_64)fill_d(TO_WHOLE), half = whole >> 1;
    vec_64 rest = whole - half; /* in two factors, since the smallest results are not normal */
    return series * (vec_d)((half + 1023) << 52) * (vec_d)((rest + 1023) << 52);
}
