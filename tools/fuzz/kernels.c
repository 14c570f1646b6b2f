/* SPDX-License-Identifier: Apache-2.0 */
/* libFuzzer target: arbitrary packets through both kernels.
 *
 * The first bytes of an input select geometry and options, the rest is the stream. One option
 * corrects the check words of the headers, and the build accepts every CRC, so that the fuzzer
 * reaches the chunks. All buffers have exactly the size that the kernels require, so that
 * AddressSanitizer detects any access past their end. The sums of the counts are checked too. */
#include <stdio.h>

#include "wire.h"
#include "crc32c.h"
#include "scan.h"
#include "rows.h"
#define CODE_WIDTHS(X) X(1) X(2) X(4) X(7) X(8) X(9) X(13) /* those of GEOMETRIES */
#include "count.h"

enum { OPTIONS = 4, OTHERS = 3 };
enum { FINAL = 1, MEND = 2, WIDE = 4 };

static const struct { unsigned rows, cols, bits; size_t chunks; } GEOMETRIES[] = {
    {1, 1, 1, 4}, {3, 5, 9, 64}, {8, 8, 9, 64}, {1, 2, 13, 16}, {10, 13, 8, 256},
    {5, 64, 7, 64}, {32, 32, 4, 1024}, {256, 8, 2, 600},
};

static void check(int holds, const char *what)
{
    if (!holds) {
        fprintf(stderr, "check failed: %s\n", what);
        abort();
    }
}

/* Correct the check words of all headers. */
static void mend(uint8_t *data, size_t size)
{
    for (size_t at = 0; (at = find_magic(data, at, size)) + OTHER_HEADER <= size; at++) {
        size_t bytes = load16(data + at + AT_HEADER_BYTES);
        if (bytes % 8 || bytes < OTHER_HEADER || bytes > MAX_HEADER || at + bytes > size)
            continue;
        uint32_t word = 0;
        for (size_t i = 0; i < bytes - 4; i += 4)
            word ^= load32(data + at + i);
        for (unsigned i = 0; i < 4; i++)
            data[at + bytes - 4 + i] = (uint8_t)(word >> 8 * i);
    }
}

static uint64_t total(const Count *count)
{
    uint64_t sum = 0;
    for (size_t i = 0; i < (size_t)count->pixels << count->code_bits; i++)
        sum += count->wide ? ((uint32_t *)count->out)[i] : ((uint16_t *)count->out)[i];
    return sum;
}

/* Count the scanned frames with every policy; the sums must match the number of frames. */
static void count_frames(const Scan *scan, unsigned options)
{
    size_t pixels = (size_t)scan->rows * scan->cols;
    size_t chunks = (pixels + scan->run - 1) / scan->run;
    uint32_t *chosen = malloc(scan->frames * sizeof *chosen);
    for (uint32_t i = 0; i < scan->frames; i++)
        chosen[i] = (uint32_t)scan->frames - 1 - i;
    Count count = {
        .data = scan->data, .size = scan->size, .pixels = (unsigned)pixels,
        .code_bits = scan->code_bits, .run = scan->run, .chunks = scan->chunks,
        .stride = scan->stride, .chosen = chosen, .frames = scan->frames,
        .wide = !!(options & WIDE),
    };
    size_t bytes = (pixels << scan->code_bits) * (count.wide ? 4 : 2);
    count.out = calloc(bytes, 1);
    count.done = calloc(chunks * ((scan->run + TILE - 1) / TILE), 1);
    for (int mode = ADD; mode <= SUBTRACT; mode++) {
        uint64_t before = total(&count);
        if (mode == STORE || mode == SATURATE)
            memset(count.done, 0, chunks * ((scan->run + TILE - 1) / TILE));
        count.mode = mode;
        check(count_chunks(&count, 0, chunks / 2) == OK, "first half");
        check(count_chunks(&count, chunks / 2, chunks) == OK, "second half");
        uint64_t frames = scan->frames * pixels, after = total(&count);
        check(mode == STORE ? after == frames : mode == SUBTRACT ? after + frames == before
                           : after == before + frames, "sum of counts");
        check(!count.pending && !count.clipped, "no counter is full");
    }
    free(count.out);
    free(count.done);
    free(chosen);
}

int LLVMFuzzerTestOneInput(const uint8_t *input, size_t size)
{
    static int started, here_avx512;
    if (!started++) {
        start_kernels();
        here_avx512 = has_avx512;
    }
    if (size < OPTIONS)
        return 0;
    unsigned options = input[1];
    size_t limit = 1 + input[2] % 7, kinds = sizeof GEOMETRIES / sizeof *GEOMETRIES;
    has_bit_instructions = input[3] & 1;
    has_crc_instruction = input[3] >> 1 & 1;
    has_avx2 = input[3] >> 2 & 1;
    has_avx512 = here_avx512 && input[3] >> 3 & 1;
    uint8_t *data = malloc(size - OPTIONS ? size - OPTIONS : 1);
    memcpy(data, input + OPTIONS, size - OPTIONS);
    if (options & MEND)
        mend(data, size - OPTIONS);
    State state = {.in_step = 1};
    Scan scan = {
        .data = data, .size = size - OPTIONS, .rows = GEOMETRIES[input[0] % kinds].rows,
        .cols = GEOMETRIES[input[0] % kinds].cols, .code_bits = GEOMETRIES[input[0] % kinds].bits,
        .state = &state, .chunks_size = GEOMETRIES[input[0] % kinds].chunks, .frame_limit = limit,
        .others_limit = OTHERS,
    };
    scan.chunks = malloc(scan.chunks_size * sizeof *scan.chunks);
    scan.headers = malloc(limit * FRAME_HEADER);
    scan.places = malloc(limit * 16);
    scan.others = malloc(OTHERS * 16);
    size_t at = 0;
    while (!scan.ended) {
        scan.others_count = 0;
        size_t next = scan_packets(&scan, at, options & FINAL);
        check(next >= at && next <= scan.size, "position");
        check(scan.ended || next > at || scan.frames, "progress");
        at = next;
        if (scan.frames)
            count_frames(&scan, options);
        scan.frames = 0;
        scan.run = 0;
    }
    check(!(options & FINAL) || at == scan.size, "end");
    free(scan.chunks);
    free(scan.headers);
    free(scan.places);
    free(scan.others);
    free(data);
    return 0;
}
