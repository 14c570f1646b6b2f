/* SPDX-License-Identifier: Apache-2.0 */
/* Counts of LANES pixels side by side: for each bin a vector, which holds one pixel in each lane. */

/* Where the first bin of each pixel is. */
typedef struct {
    const Light *light; /* dense */
    const char *rows[LANES];
} Source;

/* 16 bytes of every fourth row, side by side. */
INLINE ivec quarters(const char *const *rows, Py_ssize_t at)
{
#if defined(__AVX512F__) && LANES == 16
    __m512i x = _mm512_castsi128_si512(_mm_loadu_si128((const __m128i *)(rows[0] + at)));
    x = _mm512_inserti32x4(x, _mm_loadu_si128((const __m128i *)(rows[4] + at)), 1);
    x = _mm512_inserti32x4(x, _mm_loadu_si128((const __m128i *)(rows[8] + at)), 2);
    return (ivec)_mm512_inserti32x4(x, _mm_loadu_si128((const __m128i *)(rows[12] + at)), 3);
#elif defined(__AVX2__) && LANES == 8
    __m256i x = _mm256_castsi128_si256(_mm_loadu_si128((const __m128i *)(rows[0] + at)));
    return (ivec)_mm256_inserti128_si256(x, _mm_loadu_si128((const __m128i *)(rows[4] + at)), 1);
#else
    ivec x;
    for (int i = 0; i < LANES; i += 4)
        memcpy((char *)&x + 4 * i, rows[i] + at, 16);
    return x;
#endif
}

/* Of every four lanes the first two of both vectors, or with `upper` the last two, by turns: pieces of
 * one lane or of two. */
INLINE ivec by_turns(ivec a, ivec b, int piece, int upper)
{
    ivec lanes = lane_numbers(), within = lanes & 3, four = lanes - within;
    ivec first = four + 2 * upper + (piece == 1 ? within >> 1 : within & 1);
    return joined(a, b, first + LANES * (piece == 1 ? within & 1 : within >> 1));
}

/* Four words of 32 bits at a place of each row: for each word a vector. */
INLINE void read_four(const Source *source, Py_ssize_t at, ivec *words)
{
    ivec x[4], y[4];
    /* There are more rows than registers: without this, compilers keep them in those of vectors. */
    __asm__ volatile("" : : : "memory");
    for (int i = 0; i < 4; i++)
        x[i] = quarters(source->rows + i, at);
    for (int i = 0; i < 4; i++)
        y[i] = by_turns(x[i & 2], x[(i & 2) + 1], 1, i & 1); /* words 0 and 1, then 2 and 3 */
    for (int i = 0; i < 4; i++)
        words[i] = by_turns(y[i >> 1], y[(i >> 1) + 2], 2, i & 1);
}

/* Eight bins of 16 bits from one on. */
INLINE void read_eight_16(const Source *source, int bin, int back, vec *counts)
{
    ivec words[4];
    read_four(source, back ? -2 * (bin + 7) : 2 * bin, words);
    for (int i = 0; i < 4; i++) {
        vec first = __builtin_convertvector(first_of(words[i]), vec);
        vec second = __builtin_convertvector(second_of(words[i]), vec);
        counts[bin + (back ? 7 - 2 * i : 2 * i)] = first;
        counts[bin + (back ? 6 - 2 * i : 2 * i + 1)] = second;
    }
}

/* Four bins of 32 bits, the first to place `at`. */
INLINE void read_four_32(const Source *source, int at, int bin, vec *counts)
{
    int back = source->light->bin_step < 0;
    ivec words[4];
    read_four(source, back ? -4 * (bin + 3) : 4 * bin, words);
    for (int i = 0; i < 4; i++)
        counts[at + (back ? 3 - i : i)] = source->light->type == 'f'
                                           ? (vec)words[i]
                                           : __builtin_convertvector((uvec)words[i], vec);
}

/* Sums of the first and of the last four of eight bins of 16 bits. */
INLINE void sum_eight_16(const Source *source, int bin, int back, vec *made)
{
    ivec words[4];
    read_four(source, back ? -2 * (bin + 7) : 2 * bin, words);
    for (int i = 0; i < 2; i++) {
        ivec a = words[2 * i], b = words[2 * i + 1];
        ivec four = first_of(a) + second_of(a) + first_of(b) + second_of(b);
        made[back ? 1 - i : i] = __builtin_convertvector(four, vec);
    }
}

/* Sum of four bins of 32 bits. */
INLINE vec sum_four_32(const Source *source, int bin)
{
    vec counts[4];
    read_four_32(source, 0, bin, counts);
    return counts[0] + counts[1] + counts[2] + counts[3];
}

/* One bin, wherever there are too few for the others. */
INLINE void read_one(const Source *source, int bin, vec *counts)
{
    const Light *light = source->light;
    float x[LANES];
    for (int lane = 0; lane < LANES; lane++)
        read_row(light, source->rows[lane] + bin * light->bin_step, 1, x + lane);
    counts[bin] = load(x);
}

/* Counts from one bin up to another, each to its place in `counts`. Where they do not fill the last
 * block, bins before them are read again. */
APART void read_side_by_side(const Source *source, int from, int to, vec *counts)
{
    int block = source->light->type == 'H' ? 8 : 4, back = source->light->bin_step < 0;
    if (to < block)
        for (; from < to; from++)
            read_one(source, from, counts);
    for (; from < to; from += block) {
        int bin = from + block <= to ? from : to - block;
        if (block == 4)
            read_four_32(source, bin, bin, counts);
        else if (back)
            read_eight_16(source, bin, 1, counts);
        else
            read_eight_16(source, bin, 0, counts);
    }
}
