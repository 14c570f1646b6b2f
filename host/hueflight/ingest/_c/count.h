/* SPDX-License-Identifier: Apache-2.0 */
/* count: add the codes of a block of frames to histograms, one chunk of pixels at a time. */
#ifndef CODE_WIDTHS /* the fuzzer compiles only the widths that it uses */
#define CODE_WIDTHS(X) \
    X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11) X(12) X(13) X(14) X(15) X(16)
#endif
#include "tiles.h"
#include "window_counters.h"

INLINE int count_chunk(Count *count, size_t chunk, const unsigned bits, const int fast)
{
    size_t first = chunk * count->run, left = count->pixels - first;
    Shape shape = chunk_shape(left < count->run ? (unsigned)left : count->run, bits);
    if (!sort_chunk(count, chunk, &shape))
        return 0;
    uint8_t *done = count->done + chunk * ((count->run + TILE - 1) / TILE);
    if (count->sparse_count && !count->dense_count && !count->spread
        && count_in_window(count, first, shape.pixels, done, bits, fast))
        return 1;
    for (unsigned at = 0; at < shape.pixels; at += TILE, done++) {
        unsigned pixels = shape.pixels - at < TILE ? shape.pixels - at : TILE;
        int touched = count->dense_count > 0;
        if (pixels == TILE)
            count_dense_tile(count, first, at, TILE, bits, fast);
        else
            count_dense_tile(count, first, at, pixels, bits, fast);
        if (count->sparse_count)
            touched |= count_sparse_tile(count, first, at, pixels, bits, fast) > 0;
        const size_t codes = (size_t)1 << bits, stride = codes + SPARE;
        count->put(count, (Seen){count->tile, stride, 0, touched ? codes : 0}, first + at, pixels,
                   done);
        for (unsigned row = 0; touched && row < pixels; row++)
            clear_row(count->rows[row], codes);
    }
    return 1;
}

INLINE int count_any(Count *count, size_t chunk, const int fast)
{
    switch (count->code_bits) {
#define X(n) case n: return count_chunk(count, chunk, n, fast);
    CODE_WIDTHS(X)
#undef X
    }
    return 0;
}

static int count_plain(Count *count, size_t chunk) { return count_any(count, chunk, 0); }
#ifdef X86_DISPATCH
__attribute__((target("popcnt,bmi,bmi2")))
static int count_with_bit_instructions(Count *count, size_t chunk)
{
    return count_any(count, chunk, 1);
}
#endif

enum { OK, NO_MEMORY, BAD_CHUNK };

static int count_chunks(Count *count, size_t begin, size_t end)
{
    int (*one)(Count *, size_t) = count_plain;
    count->put = put_plain;
#ifdef X86_DISPATCH
    if (has_bit_instructions)
        one = count_with_bit_instructions;
    if (has_avx2)
        count->put = put_with_avx2;
#endif
    size_t room = count->frames ? count->frames : 1;
    count->all = (count->pixels + count->run - 1) / count->run;
    int result = NO_MEMORY;
    const size_t stride = ((size_t)1 << count->code_bits) + SPARE;
    const size_t rows = count->pixels < TILE ? count->pixels : TILE;
    count->tile = calloc(rows * stride, sizeof(uint16_t));
    count->window = calloc((count->run < count->pixels ? count->run : count->pixels) * WINDOW_CODES,
                           sizeof(uint16_t));
    count->dense = malloc(room * sizeof *count->dense);
    count->sparse = malloc(room * sizeof *count->sparse);
    count->ordered = malloc(room * sizeof *count->ordered);
    count->found = malloc(room * sizeof *count->found);
    count->sorted = malloc(room * sizeof *count->sorted);
    for (size_t row = 0; count->tile && row < rows; row++)
        count->rows[row] = count->tile + row * stride;
    if (count->tile && count->window && count->dense && count->sparse && count->ordered
        && count->found && count->sorted) {
        result = OK;
        for (size_t chunk = begin; result == OK && chunk < end; chunk++)
            if (!one(count, chunk))
                result = BAD_CHUNK;
    }
    free(count->tile);
    free(count->window);
    free(count->dense);
    free(count->sparse);
    free(count->ordered);
    free(count->found);
    free(count->sorted);
    return result;
}
