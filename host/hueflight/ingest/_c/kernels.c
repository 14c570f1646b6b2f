/* SPDX-License-Identifier: Apache-2.0 */
/* Packets to histograms, at the rate of the sensor chip: the extension module.
 *
 * Two kernels. numpy_kernels.py holds the reference implementation of each, which is also the
 * fallback and gives bit-identical results.
 *
 *   scan   finds the packets in a piece of a byte stream and records where their chunks lie;
 *   count  counts the codes of those frames.
 *
 * Nothing read from a packet is used as an offset or a size before it has been checked. Both
 * kernels run without the interpreter's lock and touch only buffers that the caller holds. */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include "wire.h"
#include "crc32c.h"
#include "scan.h"
#include "rows.h"
#include "count.h"

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
