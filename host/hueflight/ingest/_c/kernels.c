/* SPDX-License-Identifier: Apache-2.0 */
/* Packets to histograms, at the rate of the sensor chip: the extension module.
 *
 * numpy_kernels.py holds the reference implementation of each kernel, which is also the fallback
 * and gives identical counts.
 *
 *   scan          finds the packets in a piece of a byte stream and records where their chunks lie;
 *   count         counts the codes of those frames;
 *   group_counts  counts those of a histogram by tiles of pixels and groups of codes;
 *   gather        adds a histogram to a sum that begins anew in some tiles;
 *   significance  compares counts with what earlier ones predict.
 *
 * Nothing read from a packet is used as an offset or a size before it has been checked. The
 * kernels run without the interpreter's lock and touch only buffers that the caller holds. */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include "wire.h"
#include "crc32c.h"
#include "scan.h"
#include "rows.h"
#include "count.h"
#include "gather.h"
#include "scene_change.h"

typedef struct { Py_buffer view; int held; } Held;

/* A buffer argument of at least `least` bytes. */
static int hold(Held *held, PyObject *object, const char *name, int writable, size_t least)
{
    if (PyObject_GetBuffer(object, &held->view, writable ? PyBUF_WRITABLE : PyBUF_SIMPLE))
        return 0;
    held->held = 1;
    if ((size_t)held->view.len < least) {
        PyErr_Format(PyExc_ValueError, "%s has %zd bytes, fewer than the %zu it needs", name,
                     held->view.len, least);
        return 0;
    }
    return 1;
}

static void release(Held *held, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (held[i].held)
            PyBuffer_Release(&held[i].view);
}

/* scan(data, start, final, rows, cols, code_bits, frames, limit, run, state, chunks, headers,
 *      places, others) -> (position, frames, others, run, stride, needed, ended)
 * The tables already hold `frames` frames of run length `run`; new frames are appended. */
static PyObject *py_scan(PyObject *self, PyObject *args)
{
    (void)self;
    PyObject *data, *state, *chunks, *headers, *places, *others, *answer = NULL;
    Py_ssize_t start, frames, limit;
    int final, rows, cols, bits, run;
    if (!PyArg_ParseTuple(args, SCAN_ARGUMENTS, &data, &start, &final, &rows, &cols, &bits,
                          &frames, &limit, &run, &state, &chunks, &headers, &places, &others))
        return NULL;
    if (start < 0 || frames < 0 || frames > limit || limit < 1 || limit > MOST_FRAMES || run < 0
        || run > MAX_RUN || run % 8 || rows < 1 || rows > MAX_SIDE || cols < 1 || cols > MAX_SIDE
        || bits < 1 || bits > MAX_BITS) {
        PyErr_SetString(PyExc_ValueError, "scan: argument out of range");
        return NULL;
    }
    Held held[6] = {0};
    if (hold(&held[0], data, "data", 0, (size_t)start)
        && hold(&held[1], state, "state", 1, sizeof(State))
        && hold(&held[2], chunks, "chunks", 1, sizeof(uint64_t))
        && hold(&held[3], headers, "headers", 1, (size_t)limit * FRAME_HEADER)
        && hold(&held[4], places, "places", 1, (size_t)limit * 16)
        && hold(&held[5], others, "others", 1, 16)) {
        size_t pixels = (size_t)rows * (size_t)cols, room = (size_t)held[2].view.len / 8;
        size_t stride = run ? room / ((pixels + (size_t)run - 1) / (size_t)run) : 0;
        if ((size_t)held[0].view.len > UINT32_MAX)
            PyErr_SetString(PyExc_ValueError, "scan: more than 4 GiB at once");
        else if (frames && (size_t)frames > stride)
            PyErr_SetString(PyExc_ValueError, "scan: more frames than the table of chunks holds");
        else {
            Scan scan = {
                .data = held[0].view.buf, .size = (size_t)held[0].view.len,
                .rows = (unsigned)rows, .cols = (unsigned)cols, .code_bits = (unsigned)bits,
                .state = held[1].view.buf, .chunks = held[2].view.buf,
                .chunks_size = room, .frames = (size_t)frames, .run = (unsigned)run,
                .stride = stride, .frame_limit = (size_t)limit,
                .headers = held[3].view.buf, .places = held[4].view.buf,
                .others = held[5].view.buf, .others_limit = (size_t)held[5].view.len / 16,
            };
            size_t at;
            Py_BEGIN_ALLOW_THREADS
            at = scan_packets(&scan, (size_t)start, final);
            Py_END_ALLOW_THREADS
            answer = Py_BuildValue("nnnInnO", (Py_ssize_t)at, (Py_ssize_t)scan.frames,
                                   (Py_ssize_t)scan.others_count, scan.run,
                                   (Py_ssize_t)scan.stride, (Py_ssize_t)scan.needed,
                                   scan.ended ? Py_True : Py_False);
        }
    }
    release(held, 6);
    return answer;
}

/* count(data, chunks, stride, chosen, pixels, code_bits, run, out, wide, mode, done, begin,
 *       end) -> (photons, clipped, pending) */
static PyObject *py_count(PyObject *self, PyObject *args)
{
    (void)self;
    PyObject *data, *chunks, *chosen, *out, *done, *answer = NULL;
    Py_ssize_t stride, begin, end;
    int pixels, bits, run, wide, mode;
    if (!PyArg_ParseTuple(args, COUNT_ARGUMENTS, &data, &chunks, &stride, &chosen, &pixels, &bits,
                          &run, &out, &wide, &mode, &done, &begin, &end))
        return NULL;
    if (pixels < 1 || pixels > MAX_SIDE * MAX_SIDE || bits < 1 || bits > MAX_BITS || run < MIN_RUN
        || run > MAX_RUN || run % 8 || mode < ADD || mode > SUBTRACT || stride < 1 || begin < 0
        || end < begin || end > (pixels + run - 1) / run || stride > INT32_MAX) {
        PyErr_SetString(PyExc_ValueError, "count: argument out of range");
        return NULL;
    }
    size_t all = ((size_t)pixels + (size_t)run - 1) / (size_t)run;
    Held held[5] = {0};
    if (hold(&held[0], data, "data", 0, 0)
        && hold(&held[1], chunks, "chunks", 0, all * (size_t)stride * 8)
        && hold(&held[2], chosen, "chosen", 0, 0)
        && hold(&held[3], out, "out", 1, ((size_t)pixels << bits) * (wide ? 4 : 2))
        && hold(&held[4], done, "done", 1, all * (((size_t)run + TILE - 1) / TILE))) {
        Count count = {
            .data = held[0].view.buf, .size = (size_t)held[0].view.len,
            .pixels = (unsigned)pixels, .code_bits = (unsigned)bits, .run = (unsigned)run,
            .chunks = held[1].view.buf, .stride = (size_t)stride, .chosen = held[2].view.buf,
            .frames = (size_t)held[2].view.len / 4, .out = held[3].view.buf, .wide = wide,
            .mode = mode, .done = held[4].view.buf,
        };
        int fits = count.frames <= MOST_FRAMES;
        for (size_t i = 0; i < count.frames; i++)
            fits &= count.chosen[i] < (uint64_t)stride;
        if (!fits)
            PyErr_SetString(PyExc_ValueError, "count: chosen frames out of range");
        else {
            int result;
            Py_BEGIN_ALLOW_THREADS
            result = count_chunks(&count, (size_t)begin, (size_t)end);
            Py_END_ALLOW_THREADS
            if (result == NO_MEMORY)
                PyErr_NoMemory();
            else if (result == BAD_CHUNK)
                PyErr_SetString(PyExc_ValueError, "count: a chunk lies outside the data");
            else
                answer = Py_BuildValue("KKn", (unsigned long long)count.photons,
                                       (unsigned long long)count.clipped,
                                       (Py_ssize_t)count.pending);
        }
    }
    release(held, 5);
    return answer;
}

/* Bytes of a table (row, col, code); 0 if its shape is impossible. */
static size_t table_bytes(Py_ssize_t rows, Py_ssize_t cols, Py_ssize_t codes, int wide)
{
    if (rows < 1 || rows > MAX_SIDE || cols < 1 || cols > MAX_SIDE || codes < 1
        || codes > (Py_ssize_t)1 << MAX_BITS)
        return 0;
    return (size_t)rows * (size_t)cols * (size_t)codes * (wide ? 4 : 2);
}

static size_t tiles_along(Py_ssize_t pixels)
{
    return ((size_t)pixels + SCENE_TILE - 1) / SCENE_TILE;
}

/* group_counts(histogram, wide, rows, cols, codes, group, leave_first, out) */
static PyObject *py_group_counts(PyObject *self, PyObject *args)
{
    (void)self;
    PyObject *histogram, *out, *answer = NULL;
    Py_ssize_t rows, cols, codes, group;
    int wide, leave_first;
    if (!PyArg_ParseTuple(args, GROUP_COUNTS_ARGUMENTS, &histogram, &wide, &rows, &cols, &codes,
                          &group, &leave_first, &out))
        return NULL;
    const size_t bytes = table_bytes(rows, cols, codes, wide);
    if (!bytes || group < 1) {
        PyErr_SetString(PyExc_ValueError, "group_counts: argument out of range");
        return NULL;
    }
    const size_t groups = ((size_t)codes + (size_t)group - 1) / (size_t)group;
    Held held[2] = {0};
    if (hold(&held[0], histogram, "histogram", 0, bytes)
        && hold(&held[1], out, "out", 1, tiles_along(rows) * tiles_along(cols) * groups * 8)) {
        GroupCounts g = {
            .histogram = held[0].view.buf, .rows = (size_t)rows, .cols = (size_t)cols,
            .codes = (size_t)codes, .group = (size_t)group, .wide = wide,
            .leave_first = leave_first, .room = malloc((size_t)codes * sizeof(uint64_t)),
            .out = held[1].view.buf,
        };
        if (!g.room)
            PyErr_NoMemory();
        else {
            Py_BEGIN_ALLOW_THREADS
            group_counts(&g);
            Py_END_ALLOW_THREADS
            answer = Py_None;
            Py_INCREF(answer);
        }
        free(g.room);
    }
    release(held, 2);
    return answer;
}

/* gather(total, total_wide, histogram, histogram_wide, anew, rows, cols, codes, out, out_wide) */
static PyObject *py_gather(PyObject *self, PyObject *args)
{
    (void)self;
    PyObject *total, *histogram, *anew, *out, *answer = NULL;
    Py_ssize_t rows, cols, codes;
    int total_wide, histogram_wide, out_wide;
    if (!PyArg_ParseTuple(args, GATHER_ARGUMENTS, &total, &total_wide, &histogram,
                          &histogram_wide, &anew, &rows, &cols, &codes, &out, &out_wide))
        return NULL;
    if (!table_bytes(rows, cols, codes, 0) || (total_wide && !out_wide)) {
        PyErr_SetString(PyExc_ValueError, "gather: argument out of range");
        return NULL;
    }
    Held held[4] = {0};
    if (hold(&held[0], total, "total", 0, table_bytes(rows, cols, codes, total_wide))
        && hold(&held[1], histogram, "histogram", 0,
                table_bytes(rows, cols, codes, histogram_wide))
        && hold(&held[2], anew, "anew", 0, tiles_along(rows) * tiles_along(cols))
        && hold(&held[3], out, "out", 1, table_bytes(rows, cols, codes, out_wide))) {
        Gather g = {
            .total = held[0].view.buf, .histogram = held[1].view.buf, .anew = held[2].view.buf,
            .rows = (size_t)rows, .cols = (size_t)cols, .codes = (size_t)codes,
            .total_wide = total_wide, .histogram_wide = histogram_wide, .out_wide = out_wide,
            .out = held[3].view.buf,
        };
        Py_BEGIN_ALLOW_THREADS
        gather(&g);
        Py_END_ALLOW_THREADS
        answer = Py_None;
        Py_INCREF(answer);
    }
    release(held, 4);
    return answer;
}

/* significance(newest, earlier, ratio, rows, cols, groups, size, window, brightness_tolerance,
 *              shift_tolerance, out) */
static PyObject *py_significance(PyObject *self, PyObject *args)
{
    (void)self;
    PyObject *newest, *earlier, *ratio, *out, *answer = NULL;
    Py_ssize_t rows, cols, groups, size, window;
    double brightness_tolerance, shift_tolerance;
    if (!PyArg_ParseTuple(args, SIGNIFICANCE_ARGUMENTS, &newest, &earlier, &ratio, &rows, &cols,
                          &groups, &size, &window, &brightness_tolerance, &shift_tolerance, &out))
        return NULL;
    if (!table_bytes(rows, cols, groups, 0) || groups < 2 || size < 1 || window < 1) {
        PyErr_SetString(PyExc_ValueError, "significance: argument out of range");
        return NULL;
    }
    const size_t tiles = (size_t)rows * (size_t)cols * sizeof(double);
    const size_t cells = ((size_t)rows + (size_t)size - 1) / (size_t)size
                         * (((size_t)cols + (size_t)size - 1) / (size_t)size);
    Held held[4] = {0};
    if (hold(&held[0], newest, "newest", 0, tiles * (size_t)groups)
        && hold(&held[1], earlier, "earlier", 0, tiles * (size_t)groups)
        && hold(&held[2], ratio, "ratio", 0, tiles)
        && hold(&held[3], out, "out", 1, cells * sizeof(double))) {
        Comparison c = {
            .newest = held[0].view.buf, .earlier = held[1].view.buf, .ratio = held[2].view.buf,
            .rows = (size_t)rows, .cols = (size_t)cols, .groups = (size_t)groups,
            .size = (size_t)size, .window = (size_t)window,
            .brightness_tolerance = brightness_tolerance, .shift_tolerance = shift_tolerance,
            .room = malloc((4 * (size_t)groups + SMOOTHINGS) * sizeof(double)),
            .out = held[3].view.buf,
        };
        if (!c.room)
            PyErr_NoMemory();
        else {
            Py_BEGIN_ALLOW_THREADS
            compare_cells(&c);
            Py_END_ALLOW_THREADS
            answer = Py_None;
            Py_INCREF(answer);
        }
        free(c.room);
    }
    release(held, 4);
    return answer;
}

static PyObject *py_crc32c(PyObject *self, PyObject *data)
{
    (void)self;
    Held held = {0};
    PyObject *answer = NULL;
    if (hold(&held, data, "data", 0, 0)) {
        uint32_t crc;
        Py_BEGIN_ALLOW_THREADS
        crc = crc32c(held.view.buf, (size_t)held.view.len);
        Py_END_ALLOW_THREADS
        answer = PyLong_FromUnsignedLong(crc);
    }
    release(&held, 1);
    return answer;
}

static PyMethodDef methods[] = {
    {"scan", py_scan, METH_VARARGS, "Find packets in a piece of a byte stream."},
    {"count", py_count, METH_VARARGS, "Count the codes of scanned frames."},
    {"group_counts", py_group_counts, METH_VARARGS, "Count by tiles and groups of codes."},
    {"gather", py_gather, METH_VARARGS, "Add a histogram to a sum."},
    {"significance", py_significance, METH_VARARGS, "Compare counts with earlier ones."},
    {"crc32c", py_crc32c, METH_O, "CRC-32C of a buffer."},
    {NULL, NULL, 0, NULL},
};

static int start_up(PyObject *module)
{
    start_kernels();
    return PyModule_AddStringConstant(module, "ABI", ABI);
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)start_up}, {0, NULL}};
static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", "Packets to histograms (private).", 0, methods, slots,
    NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModuleDef_Init(&definition); }
