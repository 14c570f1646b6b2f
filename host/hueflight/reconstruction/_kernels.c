/* The extension module: reconstruction's loops for Python. Their definitions and oracles are fit.py,
 * changes.py and paper.py.
 *
 * Works on tiles of pixels that stay in the cache, without the interpreter's lock, and touches
 * only buffers that the caller holds; kernels.py has checked their sizes. */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <stdlib.h>

#include "_vector.h"
#include "_tables.h"
#include "_scoring.h"
#include "_search.h"
#include "_likelihood.h"
#include "_counts.h"
#include "_fit.h"
#include "_changes.h"
#include "_paper.h"

#ifndef MODULE
#define MODULE _kernels
#endif
#define NAMED(x, y) x##y
#define INIT(name) NAMED(PyInit_, name)
#define QUOTED(x) #x
#define TEXT(name) QUOTED(name)

static size_t vectors(int bins) { return (size_t)((bins + LANES - 1) / LANES * LANES); }

static void *take(char **place, size_t bytes)
{
    char *here = *place;
    *place += (bytes + 63) / 64 * 64;
    return here;
}

/* All scratch memory from one block, or NULL. */
static char *make_scratch(const Plan *plan, Scratch *scratch)
{
    scratch->lags = vectors(plan->coarse.lags);
    scratch->fine_stride = (size_t)plan->fine.blocks * LANES + 16; /* not a power of two */
    scratch->rough_stride = (size_t)plan->rough.blocks * LANES + 16;
    size_t work = 5 * sizeof(vec) * (size_t)plan->fine.blocks;
    size_t bytes = 64 * 16
                 + TILE * 4 * (scratch->fine_stride + scratch->rough_stride)
                 + 8 * vectors(plan->bins) + PARTY * 5 * scratch->lags + work
                 + sizeof(Equations) + TRACKS * sizeof(Track);
    char *block = calloc(bytes, 1);
    if (!block)
        return NULL;
    char *place = (char *)(((uintptr_t)block + 63) / 64 * 64);
    scratch->fine = take(&place, TILE * 4 * scratch->fine_stride);
    scratch->rough = take(&place, TILE * 4 * scratch->rough_stride);
    scratch->sensor = take(&place, 4 * vectors(plan->bins));
    scratch->earlier = take(&place, 4 * vectors(plan->bins));
    scratch->scores = take(&place, PARTY * 4 * scratch->lags);
    scratch->tried = take(&place, PARTY * scratch->lags);
    scratch->work = take(&place, work);
    scratch->equations = take(&place, sizeof(Equations));
    scratch->tracks = take(&place, TRACKS * sizeof(Track));
    return block;
}

enum { LIGHT, WHICH, OFFSETS, RATES, INTEGERS, REALS, SIZES, F_WIDTHS, F_PLACES, F_RUNS, F_DATA, F_PAIRS,
       F_MEETS, F_MEETINGS, R_WIDTHS, R_PLACES, R_RUNS, R_DATA, R_PAIRS, R_MEETS, R_MEETINGS,
       C_SPANS, C_GAINS, C_COSTS, C_PLACES, C_RUNS, C_WIDTHS, C_SHARES,
       DELAY, DEVIATION, OTHER, AMPLITUDES, AMPLITUDE_STD, BACKGROUND, STEPS, BUFFERS };

static void make_plan(const Py_buffer *held, Plan *plan)
{
    const int32_t *n = held[INTEGERS].buf;
    const float *x = held[REALS].buf;
    *plan = (Plan){
        .bands = n[0], .views = n[1], .factor = n[2], .bins = n[3], .sizes = held[SIZES].buf,
        .fine = {.bins = n[4], .blocks = n[5], .phases = n[6], .first_ns = x[0],
                 .phase_ns = x[1], .widths = held[F_WIDTHS].buf, .places = held[F_PLACES].buf,
                 .runs = held[F_RUNS].buf, .data = held[F_DATA].buf,
                 .pairs = (int)(held[F_PAIRS].len / 2), .pair_bands = held[F_PAIRS].buf,
                 .meets = held[F_MEETS].buf, .meetings = held[F_MEETINGS].buf},
        .rough = {.bins = n[7], .blocks = n[8], .phases = n[9], .first_ns = x[2],
                 .phase_ns = x[3], .widths = held[R_WIDTHS].buf, .places = held[R_PLACES].buf,
                 .runs = held[R_RUNS].buf, .data = held[R_DATA].buf,
                 .pairs = (int)(held[R_PAIRS].len / 2), .pair_bands = held[R_PAIRS].buf,
                 .meets = held[R_MEETS].buf, .meetings = held[R_MEETINGS].buf},
        .coarse = {.factor = n[10], .bins = n[11], .lags = n[12], .separation = n[13],
                   .first_ns = x[4], .step_ns = x[5], .spans = held[C_SPANS].buf,
                   .gains = held[C_GAINS].buf, .costs = held[C_COSTS].buf,
                   .places = held[C_PLACES].buf, .runs = held[C_RUNS].buf,
                   .widths = held[C_WIDTHS].buf, .shares = held[C_SHARES].buf},
        .rules = {.shares = {x[6], x[7], x[8]}, .logs = {x[9], x[10], x[11]},
                  .steps = n[14], .nodes = n[15], .rounds = n[16], .rough = n[17],
                  .settle = n[18], .posterior = n[19], .few_steps = n[20], .settled = x[12],
                  .floor_photons = x[13], .floor_share = x[14], .ridge = x[15],
                  .margin = x[16], .ambiguous = x[17], .few = x[18], .spacing = x[19],
                  .spread_ns = x[20], .low_ns = x[21], .high_ns = x[22], .target_ns = x[23],
                  .raster = x[24]},
    };
}

/* Takes hold of all arguments as buffers, the first and `other` as they lie, those from `written`
 * on to be written; returns how many, or fewer with an error set. */
static int hold(PyObject *args, Py_buffer *held, int wanted, int other, int written)
{
    if (PyTuple_Size(args) != wanted) {
        PyErr_Format(PyExc_TypeError, "wants %d buffers", wanted);
        return 0;
    }
    for (int i = 0; i < wanted; i++) {
        int flags = i == LIGHT || i == other ? PyBUF_STRIDED_RO | PyBUF_FORMAT
                  : i >= written ? PyBUF_WRITABLE : PyBUF_SIMPLE;
        if (PyObject_GetBuffer(PyTuple_GetItem(args, i), &held[i], flags))
            return i;
    }
    return wanted;
}

/* Counts in a buffer; false with an error set if it is none, or some pixel of `which` is not. */
static int light_of(const Py_buffer *held, const Py_buffer *which, Light *light)
{
    char type = held->format ? held->format[0] : 0;
    if (held->ndim != 2 || (type != 'H' && type != 'I' && type != 'f')) {
        PyErr_SetString(PyExc_ValueError, "light must be (pixel, bin) of uint16, uint32 or float32");
        return 0;
    }
    *light = (Light){held->buf, held->shape[0], held->strides[0], held->strides[1], type};
    const int64_t *pixels = which->buf;
    for (Py_ssize_t i = 0; i < which->len / 8; i++)
        if (pixels[i] < 0 || pixels[i] >= light->pixels) {
            PyErr_SetString(PyExc_IndexError, "no such pixel");
            return 0;
        }
    return 1;
}

/* fit(light, which, offsets, rates, integers, reals, sizes, tables..., results...): kernels.py. */
static PyObject *py_fit(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[BUFFERS];
    PyObject *answer = NULL;
    int count = hold(args, held, BUFFERS, LIGHT, DELAY);
    Light light;
    if (count < BUFFERS || !light_of(&held[LIGHT], &held[WHICH], &light))
        goto done;
    Plan plan;
    make_plan(held, &plan);
    size_t pixels = (size_t)held[WHICH].len / 8, bands = (size_t)plan.bands;
    if (plan.bands < 1 || plan.bands > MOST_BANDS || held[LIGHT].shape[1] != plan.bins
        || (held[RATES].len && (size_t)held[RATES].len < 4 * pixels)
        || (size_t)held[OFFSETS].len < 4 * pixels || (size_t)held[DELAY].len < 4 * pixels
        || (size_t)held[DEVIATION].len < 4 * pixels || (size_t)held[OTHER].len < 4 * pixels
        || (size_t)held[AMPLITUDES].len < 4 * pixels * bands
        || (size_t)held[AMPLITUDE_STD].len < 4 * pixels * bands
        || (size_t)held[BACKGROUND].len < 4 * pixels || (size_t)held[STEPS].len < pixels) {
        PyErr_SetString(PyExc_ValueError, "fit: buffers do not fit one another");
        goto done;
    }
    Results results = {held[DELAY].buf, held[DEVIATION].buf, held[OTHER].buf,
                       held[AMPLITUDES].buf, held[AMPLITUDE_STD].buf, held[BACKGROUND].buf,
                       held[STEPS].buf};
    Scratch scratch;
    char *block = make_scratch(&plan, &scratch);
    if (!block) {
        PyErr_NoMemory();
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    fit_pixels(&plan, &light, held[WHICH].buf, pixels, held[OFFSETS].buf,
               held[RATES].len ? held[RATES].buf : NULL, &results, &scratch);
    Py_END_ALLOW_THREADS
    free(block);
    answer = Py_None;
    Py_INCREF(answer);
done:
    while (count--)
        PyBuffer_Release(&held[count]);
    return answer;
}

/* wide_sums(light, which, nothing, nothing, integers, reals, sizes, tables..., results): counts in
 * the bins of the search. */
static PyObject *py_wide_sums(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[DELAY + 1];
    PyObject *answer = NULL;
    int count = hold(args, held, DELAY + 1, LIGHT, DELAY);
    Light light;
    if (count < DELAY + 1 || !light_of(&held[LIGHT], &held[WHICH], &light))
        goto done;
    Plan plan;
    make_plan(held, &plan);
    size_t pixels = (size_t)held[WHICH].len / 8, wide = (size_t)plan.rough.bins;
    if (held[LIGHT].shape[1] != plan.bins || (size_t)held[DELAY].len < 4 * pixels * wide) {
        PyErr_SetString(PyExc_ValueError, "wide_sums: buffers do not fit one another");
        goto done;
    }
    Scratch scratch;
    char *block = make_scratch(&plan, &scratch);
    if (!block) {
        PyErr_NoMemory();
        goto done;
    }
    const int64_t *which = held[WHICH].buf;
    float *results = held[DELAY].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < pixels; i++) {
        prepare(&plan, &light, (size_t)which[i], 0, 0, &scratch);
        memcpy(results + i * wide, scratch.rough, 4 * wide);
    }
    Py_END_ALLOW_THREADS
    free(block);
    answer = Py_None;
    Py_INCREF(answer);
done:
    while (count--)
        PyBuffer_Release(&held[count]);
    return answer;
}

enum { THEN = DELAY, KEPT_AMPLITUDES, KEPT_BACKGROUND, CONTRASTS, CHANGE_BUFFERS };

/* contrasts(now, which, delays, scales, integers, reals, sizes, tables..., then, amplitudes,
 * background, results): see changes.py. */
static PyObject *py_contrasts(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[CHANGE_BUFFERS];
    PyObject *answer = NULL;
    int count = hold(args, held, CHANGE_BUFFERS, THEN, CONTRASTS);
    Light now, then;
    if (count < CHANGE_BUFFERS || !light_of(&held[LIGHT], &held[WHICH], &now)
        || !light_of(&held[THEN], &held[WHICH], &then))
        goto done;
    Plan plan;
    make_plan(held, &plan);
    size_t pixels = (size_t)held[WHICH].len / 8, bands = (size_t)plan.bands;
    if (plan.bands < 1 || plan.bands > MOST_BANDS || held[LIGHT].shape[1] != plan.bins
        || held[THEN].shape[1] != plan.rough.bins || (size_t)held[OFFSETS].len < 4 * pixels
        || (size_t)held[RATES].len < 4 * pixels || (size_t)held[CONTRASTS].len < 4 * pixels
        || (size_t)held[KEPT_AMPLITUDES].len < 4 * pixels * bands
        || (size_t)held[KEPT_BACKGROUND].len < 4 * pixels) {
        PyErr_SetString(PyExc_ValueError, "contrasts: buffers do not fit one another");
        goto done;
    }
    Scratch scratch;
    char *block = make_scratch(&plan, &scratch);
    if (!block) {
        PyErr_NoMemory();
        goto done;
    }
    const int64_t *which = held[WHICH].buf;
    const float *delays = held[OFFSETS].buf, *scales = held[RATES].buf;
    const float *amplitudes = held[KEPT_AMPLITUDES].buf, *background = held[KEPT_BACKGROUND].buf;
    float *results = held[CONTRASTS].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < pixels; i++) {
        if (i + 2 < pixels) {
            fetch(&now, (size_t)which[i + 2], plan.bins);
            fetch(&then, (size_t)which[i + 2], plan.rough.bins);
        }
        prepare(&plan, &now, (size_t)which[i], 0, 0, &scratch);
        read_counts(&then, (size_t)which[i], plan.rough.bins, scratch.rough + scratch.rough_stride);
        results[i] = contrast(&plan, scratch.rough, scratch.rough + scratch.rough_stride, scales[i],
                              delays[i], amplitudes + i * bands, background[i], scratch.work);
    }
    Py_END_ALLOW_THREADS
    free(block);
    answer = Py_None;
    Py_INCREF(answer);
done:
    while (count--)
        PyBuffer_Release(&held[count]);
    return answer;
}

/* sums(light, which, results, full): counts of each pixel, as float64, and whether a counter is at
 * the end of its type. */
static PyObject *py_sums(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[4];
    PyObject *answer = NULL;
    int count = hold(args, held, 4, LIGHT, 2);
    Light light;
    if (count < 4 || !light_of(&held[LIGHT], &held[WHICH], &light))
        goto done;
    size_t pixels = (size_t)held[WHICH].len / 8;
    if ((size_t)held[2].len < 8 * pixels || (size_t)held[3].len < pixels) {
        PyErr_SetString(PyExc_ValueError, "sums: buffers do not fit one another");
        goto done;
    }
    const int64_t *which = held[WHICH].buf;
    double *results = held[2].buf;
    uint8_t *full = held[3].buf;
    int bins = (int)held[LIGHT].shape[1];
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < pixels; i++)
        results[i] = sum_counts(&light, (size_t)which[i], bins, &full[i]);
    Py_END_ALLOW_THREADS
    answer = Py_None;
    Py_INCREF(answer);
done:
    while (count--)
        PyBuffer_Release(&held[count]);
    return answer;
}

/* correlations(light, which, integers, half_width, windows, gaps, reference, influence,
 * pixel_delays, delay, deviation, sums, background): see paper_compiled.py. */
static PyObject *py_correlations(PyObject *self, PyObject *args)
{
    (void)self;
    enum { NUMBERS = 2, HALF_WIDTH, WINDOWS, GAPS, REFERENCE, INFLUENCE, PIXEL_DELAYS, LAG, LAG_STD,
           SUMS, FLOOR, PAPER_BUFFERS };
    Py_buffer held[PAPER_BUFFERS];
    PyObject *answer = NULL;
    int count = hold(args, held, PAPER_BUFFERS, LIGHT, LAG);
    Light light;
    if (count < PAPER_BUFFERS || !light_of(&held[LIGHT], &held[WHICH], &light))
        goto done;
    if (held[NUMBERS].len != 6 * 4 || held[HALF_WIDTH].len != 8) {
        PyErr_SetString(PyExc_ValueError, "correlations: wants six integers and a width");
        goto done;
    }
    const int32_t *n = held[NUMBERS].buf;
    Paper paper = {
        .bins = (int)held[LIGHT].shape[1], .search = n[0], .reach = n[1], .most = n[2],
        .circular = n[3], .bands = n[4], .outside = n[5],
        .half_width = *(const double *)held[HALF_WIDTH].buf,
        .windows = (int)(held[WINDOWS].len / 12), .window = held[WINDOWS].buf,
        .gaps = (int)(held[GAPS].len / 8), .gap = held[GAPS].buf,
    };
    size_t pixels = (size_t)held[WHICH].len / 8, bins = (size_t)paper.bins;
    size_t kept = (size_t)light.pixels;
    int fits = paper.search >= 0 && paper.reach >= 0 && paper.reach <= paper.search
            && paper.most >= paper.search + paper.reach && paper.most <= 2 * paper.bins
            && paper.reach <= paper.bins && paper.half_width <= paper.most && paper.bands > 0
            && (size_t)held[REFERENCE].len >= 2 * bins * kept
            && (size_t)held[INFLUENCE].len >= 4 * bins * kept
            && (size_t)held[PIXEL_DELAYS].len >= 8 * kept && (size_t)held[LAG].len >= 8 * pixels
            && (size_t)held[LAG_STD].len >= 8 * pixels && (size_t)held[FLOOR].len >= 8 * pixels
            && (size_t)held[SUMS].len >= 8 * pixels * (size_t)paper.bands;
    for (int w = 0; fits && w < paper.windows; w++)
        fits = paper.window[3 * w] >= 0 && paper.window[3 * w] < paper.bands;
    for (int g = 0; fits && g < 2 * paper.gaps; g++)
        fits = paper.gap[g] >= 0 && paper.gap[g] <= paper.bins;
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "correlations: buffers do not fit one another");
        goto done;
    }
    char *block = calloc(sheet_bytes(&paper), 1);
    if (!block) {
        PyErr_NoMemory();
        goto done;
    }
    Sheet sheet;
    lay_out(&paper, (char *)(((uintptr_t)block + 63) / 64 * 64), &sheet);
    const int64_t *which = held[WHICH].buf;
    const uint16_t *reference = held[REFERENCE].buf;
    const float *influence = held[INFLUENCE].buf;
    const double *pixel_delays = held[PIXEL_DELAYS].buf;
    double *delay = held[LAG].buf, *deviation = held[LAG_STD].buf, *sums = held[SUMS].buf;
    double *background = held[FLOOR].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < pixels; i++) {
        size_t pixel = (size_t)which[i];
        if (i + 2 < pixels) {
            size_t later = (size_t)which[i + 2] * bins;
            fetch(&light, (size_t)which[i + 2], paper.bins);
            for (size_t at = 0; at < bins; at += 32)
                __builtin_prefetch(reference + later + at);
            for (size_t at = 0; at < bins; at += 16)
                __builtin_prefetch(influence + later + at);
        }
        read_counts(&light, pixel, paper.bins, sheet.light + paper.reach);
        correlate_pixel(&paper, &sheet, reference + pixel * bins, influence + pixel * bins,
                        pixel_delays[pixel], delay + i, deviation + i,
                        sums + i * (size_t)paper.bands, background + i);
    }
    Py_END_ALLOW_THREADS
    free(block);
    answer = Py_None;
    Py_INCREF(answer);
done:
    while (count--)
        PyBuffer_Release(&held[count]);
    return answer;
}

/* processor(): 2 if it knows AVX-512 (x86-64-v4), 1 if AVX2 and fused products (v3), else 0. */
static PyObject *py_processor(PyObject *self, PyObject *args)
{
    (void)self;
    (void)args;
    long able = 0;
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")
        && __builtin_cpu_supports("bmi2"))
        able = 1;
    if (able && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw")
        && __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq")
        && __builtin_cpu_supports("avx512vl"))
        able = 2;
#endif
    return PyLong_FromLong(able);
}

static PyMethodDef methods[] = {
    {"processor", py_processor, METH_NOARGS, "Which vector instructions there are: 0, 1 or 2."},
    {"sums", py_sums, METH_VARARGS, "Counts of pixels."},
    {"contrasts", py_contrasts, METH_VARARGS, "What has changed; see hueflight.reconstruction.changes."},
    {"correlations", py_correlations, METH_VARARGS, "The paper's method; see paper_compiled.py."},
    {"wide_sums", py_wide_sums, METH_VARARGS, "Counts in the bins of the search."},
    {"fit", py_fit, METH_VARARGS, "Joint fit of pixels; see hueflight.reconstruction.kernels."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, TEXT(MODULE), "The joint fit in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC INIT(MODULE)(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddIntConstant(made, "LANES", LANES)) {
        Py_DECREF(made);
        return NULL;
    }
    return made;
}
