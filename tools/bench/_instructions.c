/* SPDX-License-Identifier: Apache-2.0 */
/* Runs the kernels over a file of packets, for callgrind to count their instructions.
 *
 *     instructions FILE ROWS COLS CODE_BITS
 *
 * `measured_scan` and `measured_count` are the functions to collect (--toggle-collect). */
#include <stdio.h>

#include "wire.h"
#include "crc32c.h"
#include "scan.h"
#include "rows.h"
#include "count.h"

__attribute__((noinline)) static size_t measured_scan(Scan *scan) { return scan_packets(scan, 0, 1); }
__attribute__((noinline)) static int measured_count(Count *count, size_t chunks)
{
    return count_chunks(count, 0, chunks);
}

static uint8_t *read_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END))
        return NULL;
    *size = (size_t)ftell(file);
    rewind(file);
    uint8_t *data = malloc(*size);
    if (data && fread(data, 1, *size, file) != *size)
        return NULL;
    fclose(file);
    return data;
}

int main(int argc, char **argv)
{
    enum { FRAMES = 4096 };
    size_t size = 0;
    uint8_t *data = argc == 5 ? read_file(argv[1], &size) : NULL;
    if (!data) {
        fprintf(stderr, "usage: instructions FILE ROWS COLS CODE_BITS\n");
        return 2;
    }
    start_kernels();
    State state = {.in_step = 1};
    Scan scan = {
        .data = data, .size = size, .rows = (unsigned)atoi(argv[2]), .cols = (unsigned)atoi(argv[3]),
        .code_bits = (unsigned)atoi(argv[4]), .state = &state, .chunks_size = 1 << 20,
        .frame_limit = FRAMES, .others_limit = 64,
    };
    scan.chunks = calloc(scan.chunks_size, sizeof *scan.chunks);
    scan.headers = calloc(FRAMES, FRAME_HEADER);
    scan.places = calloc(FRAMES, 16);
    scan.others = calloc(64, 16);
    measured_scan(&scan);

    size_t pixels = (size_t)scan.rows * scan.cols;
    size_t chunks = scan.run ? (pixels + scan.run - 1) / scan.run : 0;
    uint32_t *chosen = calloc(FRAMES, sizeof *chosen);
    for (uint32_t i = 0; i < scan.frames; i++)
        chosen[i] = i;
    Count count = {
        .data = data, .size = size, .pixels = (unsigned)pixels, .code_bits = scan.code_bits,
        .run = scan.run, .chunks = scan.chunks, .stride = scan.stride, .chosen = chosen,
        .frames = scan.frames, .out = calloc(pixels << scan.code_bits, 2), .mode = ADD,
        .done = calloc(pixels, 1),
    };
    int result = chunks ? measured_count(&count, chunks) : 0;
    printf("%zu frames, %llu photons\n", scan.frames, (unsigned long long)count.photons);
    return result;
}
