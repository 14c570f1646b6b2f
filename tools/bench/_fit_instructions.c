/* SPDX-License-Identifier: Apache-2.0 */
/* Runs the joint fit over a file of its arguments, for callgrind to count its instructions.
 *
 *     fit_instructions FILE
 *
 * The file holds each argument of `fit` in its order: how many bytes it has, as 64 bits, and the bytes;
 * both begin at a multiple of 64 bytes. `measured_fit` is the function to collect (--toggle-collect). */
#include "kernels.c"
#include <stdio.h>

enum { ALIGNED = 64 };

__attribute__((noinline)) static int measured_fit(Call *call) { return run_fit(call); }

static char *read_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END))
        return NULL;
    *size = (size_t)ftell(file);
    rewind(file);
    char *data = aligned_alloc(ALIGNED, (*size + ALIGNED - 1) / ALIGNED * ALIGNED);
    if (data && fread(data, 1, *size, file) != *size)
        return NULL;
    fclose(file);
    return data;
}

int main(int argc, char **argv)
{
    size_t size = 0, at = 0;
    char *data = argc == 2 ? read_file(argv[1], &size) : NULL;
    Call call = {.count = FIT_BUFFERS};
    for (int i = 0; data && i < FIT_BUFFERS && at + ALIGNED <= size; i++) {
        int64_t bytes;
        memcpy(&bytes, data + at, sizeof bytes);
        call.held[i] = (Py_buffer){.buf = data + at + ALIGNED, .len = bytes};
        at += ALIGNED + ((size_t)bytes + ALIGNED - 1) / ALIGNED * ALIGNED;
    }
    if (!data || at != size) {
        fprintf(stderr, "usage: fit_instructions FILE\n");
        return 2;
    }
    const TableSizes *sizes = call.held[FIT_SIZES].buf;
    Py_ssize_t bins = sizes->sensor_bins, step = 2;
    Py_ssize_t shape[2] = {call.held[FIT_COUNTS].len / (bins * step), bins};
    call.held[FIT_COUNTS].shape = shape;
    call.light = (Light){call.held[FIT_COUNTS].buf, shape[0], bins * step, step, 'H'};
    call.which = call.held[FIT_PIXELS].buf;
    call.pixels = (size_t)call.held[FIT_PIXELS].len / sizeof *call.which;
    Py_Initialize();
    if (!measured_fit(&call)) {
        PyErr_Print();
        return 1;
    }
    return 0;
}
