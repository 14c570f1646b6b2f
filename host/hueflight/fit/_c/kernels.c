/* The extension module: reconstruction's loops for Python. Their definitions and oracles are fit.py,
 * changes.py and paper.py.
 *
 * Works on tiles of pixels that stay in the cache, without the interpreter's lock, and touches
 * only buffers that the caller holds; kernels.py has checked their sizes. */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <stdlib.h>

#include "vector.h"
#include "tables.h"
#include "scoring.h"
#include "search.h"
#include "likelihood.h"
#include "counts.h"
#include "fit.h"
#include "changes.h"
#include "abreast.h"
#include "correlation.h"
#include "paper.h"

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
                  .raster = x[24], .dark_width = x[25], .settled_amplitude = x[26],
                  .fewest = x[27]},
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

/* What a call of Python holds while it runs. */
typedef struct {
    int count; /* of buffers that are held */
    Py_buffer held[BUFFERS];
    Light light;
    const int64_t *which;
    size_t pixels;
    char *block; /* of scratch memory */
} Call;

static int begin(Call *call, PyObject *args, int wanted, int other, int written)
{
    call->count = hold(args, call->held, wanted, other, written);
    if (call->count < wanted || !light_of(&call->held[LIGHT], &call->held[WHICH], &call->light))
        return 0;
    call->which = call->held[WHICH].buf;
    call->pixels = (size_t)call->held[WHICH].len / 8;
    return 1;
}

static PyObject *end(Call *call, int done)
{
    free(call->block);
    while (call->count--)
        PyBuffer_Release(&call->held[call->count]);
    if (!done)
        return NULL;
    Py_INCREF(Py_None);
    return Py_None;
}

/* Whether a buffer has `size` bytes for each pixel. */
static int holds(const Call *call, int buffer, size_t size)
{
    return (size_t)call->held[buffer].len >= size * call->pixels;
}

static int refuse(const char *why)
{
    PyErr_SetString(PyExc_ValueError, why);
    return 0;
}

static int allocated(const Call *call)
{
    if (!call->block)
        PyErr_NoMemory();
    return call->block != NULL;
}

static int planned(const Call *call, Plan *plan)
{
    make_plan(call->held, plan);
    return plan->bands >= 1 && plan->bands <= MOST_BANDS
        && call->held[LIGHT].shape[1] == plan->bins;
}

static int run_fit(Call *call)
{
    const Py_buffer *held = call->held;
    Plan plan;
    int fits = planned(call, &plan);
    size_t each = 8 * (size_t)plan.bands;
    if (!fits || (held[RATES].len && !holds(call, RATES, 4)) || !holds(call, OFFSETS, 4)
        || !holds(call, DELAY, 8) || !holds(call, DEVIATION, 8) || !holds(call, OTHER, 8)
        || !holds(call, AMPLITUDES, each) || !holds(call, AMPLITUDE_STD, each)
        || !holds(call, BACKGROUND, 8) || !holds(call, STEPS, 1))
        return refuse("fit: buffers do not fit one another");
    Results results = {held[DELAY].buf, held[DEVIATION].buf, held[OTHER].buf,
                       held[AMPLITUDES].buf, held[AMPLITUDE_STD].buf, held[BACKGROUND].buf,
                       held[STEPS].buf};
    Scratch scratch;
    call->block = make_scratch(&plan, &scratch);
    if (!allocated(call))
        return 0;
    Py_BEGIN_ALLOW_THREADS
    fit_pixels(&plan, &call->light, call->which, call->pixels, held[OFFSETS].buf,
               held[RATES].len ? held[RATES].buf : NULL, &results, &scratch);
    Py_END_ALLOW_THREADS
    return 1;
}

/* fit(light, which, offsets, rates, integers, reals, sizes, tables..., results...): kernels.py. */
static PyObject *py_fit(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, BUFFERS, LIGHT, DELAY) && run_fit(&call));
}

enum { KEPT_AMPLITUDES = DELAY, KEPT_BACKGROUND, MADE, REMEMBER_BUFFERS };

static int run_remember(Call *call)
{
    const Py_buffer *held = call->held;
    Plan plan;
    int fits = planned(call, &plan);
    size_t bands = (size_t)plan.bands, room = 2 * memory_room(&plan);
    if (!fits || !holds(call, OFFSETS, 4) || !holds(call, KEPT_AMPLITUDES, 4 * bands)
        || !holds(call, KEPT_BACKGROUND, 4) || !holds(call, MADE, 4 * room))
        return refuse("remember: buffers do not fit one another");
    Scratch scratch;
    call->block = make_scratch(&plan, &scratch);
    if (!allocated(call))
        return 0;
    const float *delays = held[OFFSETS].buf, *amplitudes = held[KEPT_AMPLITUDES].buf;
    const float *background = held[KEPT_BACKGROUND].buf;
    float *memory = held[MADE].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i++) {
        const float *counts = wide_counts(&plan, &call->light, (size_t)call->which[i], &scratch);
        remember(&plan, counts, delays[i], amplitudes + i * bands, background[i], scratch.work,
                 memory + i * room);
    }
    Py_END_ALLOW_THREADS
    return 1;
}

/* remember(light, which, delays, nothing, integers, reals, sizes, tables..., amplitudes, background,
 * memory): see changes.py. */
static PyObject *py_remember(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, REMEMBER_BUFFERS, LIGHT, MADE) && run_remember(&call));
}

enum { MEMORY = DELAY, CONTRASTS, CHANGE_BUFFERS };

static int run_contrasts(Call *call)
{
    const Py_buffer *held = call->held;
    Plan plan;
    int fits = planned(call, &plan);
    size_t room = 2 * memory_room(&plan);
    if (!fits || !holds(call, OFFSETS, 4) || !holds(call, RATES, 4) || !holds(call, CONTRASTS, 4)
        || (size_t)held[MEMORY].len < 4 * room * (size_t)call->light.pixels)
        return refuse("contrasts: buffers do not fit one another");
    Scratch scratch;
    call->block = make_scratch(&plan, &scratch);
    if (!allocated(call))
        return 0;
    const float *delays = held[OFFSETS].buf, *scales = held[RATES].buf, *memory = held[MEMORY].buf;
    float *results = held[CONTRASTS].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i++) {
        size_t pixel = (size_t)call->which[i];
        if (i + 2 < call->pixels) {
            size_t next = (size_t)call->which[i + 2];
            fetch(&call->light, next, plan.bins);
            fetch_memory(memory + next * room, room);
        }
        const float *now = wide_counts(&plan, &call->light, pixel, &scratch);
        results[i] = contrast(&plan, now, memory + pixel * room, scales[i], delays[i],
                              scratch.work, scratch.work + plan.rough.blocks);
    }
    Py_END_ALLOW_THREADS
    return 1;
}

/* contrasts(now, which, delays, scales, integers, reals, sizes, tables..., memory, results): see
 * changes.py. */
static PyObject *py_contrasts(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, CHANGE_BUFFERS, LIGHT, CONTRASTS) && run_contrasts(&call));
}

enum { SPAN = 2, ALL_COUNTS, LIT_COUNTS, FULL, SUM_BUFFERS };

static int run_sums(Call *call)
{
    int bins = (int)call->held[LIGHT].shape[1];
    const int64_t *span = call->held[SPAN].buf;
    if (call->held[SPAN].len != 16 || span[0] < 0 || span[1] < span[0] || span[1] > bins
        || !holds(call, ALL_COUNTS, 8) || !holds(call, LIT_COUNTS, 8) || !holds(call, FULL, 1))
        return refuse("sums: buffers do not fit one another");
    double *all = call->held[ALL_COUNTS].buf, *lit = call->held[LIT_COUNTS].buf;
    uint8_t *full = call->held[FULL].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i++) {
        if (i + 4 < call->pixels)
            fetch(&call->light, (size_t)call->which[i + 4], bins);
        sum_counts(&call->light, (size_t)call->which[i], bins, (int)span[0], (int)span[1], all + i,
                   lit + i, full + i);
    }
    Py_END_ALLOW_THREADS
    return 1;
}

/* sums(counts, which, span, all, lit, full): counts of each pixel and those from span[0] up to
 * span[1], as float64, and whether a counter is at the end of its type. */
static PyObject *py_sums(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, SUM_BUFFERS, LIGHT, ALL_COUNTS) && run_sums(&call));
}

enum { NUMBERS = 2, HALF_WIDTH, WINDOWS, GAPS, REFERENCE, PIXEL_DELAYS, LAG, LAG_STD,
       WINDOW_SUMS, FLOOR, PAPER_BUFFERS };

/* What all pixels of a call share; false if its buffers do not fit one another. */
static int make_paper(const Call *call, Paper *paper)
{
    const Py_buffer *held = call->held;
    const int32_t *n = held[NUMBERS].buf;
    *paper = (Paper){
        .bins = (int)held[LIGHT].shape[1], .search = n[0], .reach = n[1], .most = n[2],
        .circular = n[3], .bands = n[4], .outside = n[5],
        .half_width = *(const double *)held[HALF_WIDTH].buf,
        .windows = (int)(held[WINDOWS].len / 12), .window = held[WINDOWS].buf,
        .gaps = (int)(held[GAPS].len / 8), .gap = held[GAPS].buf,
        .references = held[REFERENCE].buf, .pixel_delays = held[PIXEL_DELAYS].buf,
    };
    int fits = call->light.type != 'f' && paper->search >= 0 && paper->reach >= 0
            && paper->reach <= paper->search && paper->most >= paper->search + paper->reach
            && paper->most <= 2 * paper->bins && paper->reach <= paper->bins
            && paper->half_width <= paper->most && paper->bands > 0
            && (size_t)held[REFERENCE].len / 2
                   >= (size_t)(paper->bins + 2 * paper->most) * (size_t)call->light.pixels
            && (size_t)held[PIXEL_DELAYS].len >= 8 * (size_t)call->light.pixels
            && holds(call, LAG, 8) && holds(call, LAG_STD, 8) && holds(call, FLOOR, 8)
            && holds(call, WINDOW_SUMS, 8 * (size_t)paper->bands);
    for (int w = 0; fits && w < paper->windows; w++)
        fits = paper->window[3 * w] >= 0 && paper->window[3 * w] < paper->bands;
    for (int g = 0; fits && g < 2 * paper->gaps; g++)
        fits = paper->gap[g] >= 0 && paper->gap[g] <= paper->bins;
    return fits;
}

static int run_correlations(Call *call)
{
    const Py_buffer *held = call->held;
    if (held[NUMBERS].len != 6 * 4 || held[HALF_WIDTH].len != 8)
        return refuse("correlations: wants six integers and a width");
    Paper paper;
    if (!make_paper(call, &paper))
        return refuse("correlations: buffers do not fit one another");
    Group group;
    call->block = calloc(lay_out(&paper, NULL, &group) + 64, 1);
    if (!allocated(call))
        return 0;
    lay_out(&paper, (char *)(((uintptr_t)call->block + 63) / 64 * 64), &group);
    PaperResults results = {held[LAG].buf, held[LAG_STD].buf, held[WINDOW_SUMS].buf,
                            held[FLOOR].buf};
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i += LANES)
        correlate_group(&paper, &group, &call->light, call->which, i, call->pixels, &results);
    Py_END_ALLOW_THREADS
    return 1;
}

/* correlations(light, which, integers, half_width, windows, gaps, reference, pixel_delays, delay,
 * deviation, sums, background): see paper_compiled.py. */
static PyObject *py_correlations(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, PAPER_BUFFERS, LIGHT, LAG) && run_correlations(&call));
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
    {"remember", py_remember, METH_VARARGS, "What changes are told by."},
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
