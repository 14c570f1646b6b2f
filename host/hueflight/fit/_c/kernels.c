/* SPDX-License-Identifier: Apache-2.0 */
/* The extension module: the joint fit, change detection and the published method, for Python. Their
 * definitions are reference.py and change_detection.py of hueflight/fit and paper.py of
 * hueflight/reconstruction.
 *
 * Works on tiles of pixels that stay in the cache, without the interpreter's lock, and touches only
 * buffers that the caller holds. Arguments are those of abi.h. */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <stdlib.h>

#include "abi.h"
#include "vector.h"
#include "tables.h"
#include "counts.h"
#include "simd_transpose.h"
#include "side_by_side.h"
#include "tracks.h"
#include "scoring.h"
#include "search.h"
#include "likelihood.h"
#include "screening.h"
#include "assessment.h"
#include "fit.h"
#include "change_detection.h"
#include "correlation.h"
#include "paper.h"
#include "doubles.h"
#include "deviations.h"
#include "conversion.h"
#include "edges.h"

#ifndef MODULE
#define MODULE _kernels
#endif
#define NAMED(x, y) x##y
#define INIT(name) NAMED(PyInit_, name)
#define QUOTED(x) #x
#define TEXT(name) QUOTED(name)

/* Bins of whole blocks. */
static size_t whole(int bins) { return (size_t)((bins + BLOCK_BINS - 1) / BLOCK_BINS * BLOCK_BINS); }

/* The next part of a block of memory, or what it would be without a block. */
static void *take(char **place, size_t bytes)
{
    char *here = *place;
    *place += (bytes + 63) / 64 * 64;
    return here;
}

/* Lays out scratch memory for so many pixels from a place on; returns how many bytes it takes. `kept`
 * tells whether their fine counts need room. */
static size_t lay_out_scratch(const ModelTables *tables, int pixels, int kept, char *begin,
                              Scratch *scratch)
{
    char *place = begin;
    size_t some = (size_t)pixels, tracks = 2 * some, lags = (size_t)tables->search.lags * TOGETHER;
    size_t fine = whole(tables->fine.bins), wide = whole(tables->wide.bins);
    size_t phases = (size_t)(tables->fine.phases > tables->wide.phases ? tables->fine.phases
                                                                       : tables->wide.phases);
    size_t work = 8 * fine / LANES > 3 * wide ? 8 * fine / LANES : 3 * wide;
    scratch->fine_stride = fine + 16; /* not a power of two */
    scratch->wide_stride = wide + 16;
    scratch->fine = take(&place, kept ? some * 4 * scratch->fine_stride : 0);
    scratch->wide = take(&place, some * 4 * scratch->wide_stride);
    scratch->sensor = take(&place, 4 * whole(tables->bins));
    scratch->earlier = take(&place, 4 * whole(tables->bins));
    scratch->counts = take(&place, sizeof(vec) * fine);
    scratch->sums = take(&place, sizeof(vec) * wide * TOGETHER);
    scratch->scores = take(&place, sizeof(vec) * lags);
    scratch->shares = take(&place, sizeof(vec) * lags);
    scratch->work = take(&place, sizeof(vec) * work);
    scratch->equations = take(&place, sizeof(Equations));
    scratch->tracks = take(&place, tracks * 4 * track_room(tables->bands));
    scratch->pixel = take(&place, 4 * tracks);
    scratch->phase = take(&place, 4 * tracks);
    scratch->active = take(&place, 4 * tracks);
    scratch->sorted = take(&place, 4 * tracks);
    scratch->places = take(&place, 4 * (phases + 1));
    scratch->steps = take(&place, tracks);
    scratch->second = take(&place, 4 * some);
    scratch->rows = take(&place, sizeof(char *) * some);
    scratch->offsets = take(&place, 4 * some);
    scratch->arrivals = take(&place, 4 * some);
    scratch->others = take(&place, 4 * some);
    scratch->tested = take(&place, some);
    scratch->curves = take(&place, 4 * wide * (size_t)tables->bands);
    return (size_t)(place - begin);
}

/* Sets to 0 what follows the bins of rows, since whole vectors are read. */
static void clear_ends(float *rows, size_t count, size_t stride, int bins)
{
    for (size_t i = 0; i < count; i++)
        memset(rows + i * stride + bins, 0, (stride - (size_t)bins) * sizeof *rows);
}

/* All scratch memory from one block, or NULL. Of what is not cleared, nothing is read before it is
 * written. */
static char *make_scratch(const ModelTables *tables, int pixels, int kept, Scratch *scratch)
{
    static char nothing[64];
    size_t size = lay_out_scratch(tables, pixels, kept, nothing, scratch) + 64;
    char *block = malloc(size);
    if (!block)
        return NULL;
    lay_out_scratch(tables, pixels, kept, (char *)(((uintptr_t)block + 63) / 64 * 64), scratch);
    clear_ends(scratch->fine, kept ? (size_t)pixels : 0, scratch->fine_stride, tables->fine.bins);
    clear_ends(scratch->wide, (size_t)pixels, scratch->wide_stride, tables->wide.bins);
    clear_ends(scratch->sensor, 1, whole(tables->bins), 0);
    clear_ends(scratch->earlier, 1, whole(tables->bins), 0);
    return block;
}

/* fit, change_reference and changes begin with the same arguments. */
_Static_assert((int)FIT_SEARCH_SHARES == (int)CHANGE_REFERENCE_SEARCH_SHARES
               && (int)FIT_SEARCH_SHARES == (int)CHANGES_SEARCH_SHARES
               && (int)FIT_SIZES == (int)CHANGE_REFERENCE_SIZES
               && (int)FIT_SIZES == (int)CHANGES_SIZES, "the tables come first");
_Static_assert((int)FIT_COUNTS == 0 && (int)SUMS_COUNTS == 0 && (int)CORRELATIONS_COUNTS == 0
               && (int)FIT_PIXELS == 1 && (int)SUMS_PIXELS == 1 && (int)CORRELATIONS_PIXELS == 1,
               "counts and pixels come before everything else");
enum { COUNTS_GIVEN = FIT_COUNTS, PIXELS_GIVEN = FIT_PIXELS, MOST_BUFFERS = FIT_BUFFERS };
_Static_assert((int)CHANGE_REFERENCE_BUFFERS <= (int)MOST_BUFFERS
               && (int)CHANGES_BUFFERS <= (int)MOST_BUFFERS
               && (int)CORRELATIONS_BUFFERS <= (int)MOST_BUFFERS
               && (int)PICTURE_BUFFERS <= (int)MOST_BUFFERS, "there is room for all buffers");

#define DELAY_TABLES(LEVEL, PLACE)                                                                \
    (DelayTables)                                                                                 \
    {                                                                                             \
        .bins = sizes->LEVEL##_bins, .blocks = sizes->LEVEL##_blocks * (BLOCK_BINS / LANES),      \
        .phases = sizes->LEVEL##_phases, .first_ns = sizes->LEVEL##_first_ns,                     \
        .phase_ns = sizes->LEVEL##_phase_ns, .widths = held[FIT_##PLACE##_WIDTHS].buf,            \
        .run_places = held[FIT_##PLACE##_RUN_PLACES].buf, .runs = held[FIT_##PLACE##_RUNS].buf,   \
        .data = held[FIT_##PLACE##_DATA].buf, .segments = held[FIT_##PLACE##_SEGMENTS].buf,       \
        .segment_places = held[FIT_##PLACE##_SEGMENT_PLACES].buf,                                 \
        .lit = held[FIT_##PLACE##_LIT].buf, .sums = held[FIT_##PLACE##_SUMS].buf,                 \
        .whole = sizes->LEVEL##_whole                                                             \
    }

static void make_tables(const Py_buffer *held, ModelTables *tables)
{
    const TableSizes *sizes = held[FIT_SIZES].buf;
    const FitRules *rules = held[FIT_RULES].buf;
    *tables = (ModelTables){
        .bands = sizes->bands, .views = sizes->views, .factor = sizes->fine_factor,
        .bins = sizes->sensor_bins, .sizes = held[FIT_VIEW_BINS].buf,
        .fine = DELAY_TABLES(fine, FINE), .wide = DELAY_TABLES(wide, WIDE),
        .search = {.factor = sizes->wide_factor, .bins = sizes->search_bins, .lags = sizes->lags,
                   .separation = sizes->separation, .first_ns = sizes->first_lag_ns,
                   .step_ns = sizes->lag_ns, .gain_places = held[FIT_SEARCH_GAIN_PLACES].buf,
                   .gain_runs = held[FIT_SEARCH_GAIN_RUNS].buf,
                   .gains = held[FIT_SEARCH_GAINS].buf, .costs = held[FIT_SEARCH_COSTS].buf,
                   .places = held[FIT_SEARCH_PLACES].buf, .runs = held[FIT_SEARCH_RUNS].buf,
                   .widths = held[FIT_SEARCH_WIDTHS].buf, .shares = held[FIT_SEARCH_SHARES].buf},
        .rules = *rules,
    };
}

/* Holds all arguments as buffers: the counts, where number `counts` is one of them, with any strides,
 * the others contiguous, those after the first `reads` to be written. Returns how many, or fewer with
 * an error set. */
static int hold(PyObject *args, Py_buffer *held, int wanted, int reads, int counts)
{
    if (PyTuple_Size(args) != wanted) {
        PyErr_Format(PyExc_TypeError, "expected %d buffers", wanted);
        return 0;
    }
    for (int i = 0; i < wanted; i++) {
        int flags = i == counts ? PyBUF_STRIDED_RO | PyBUF_FORMAT
                  : i >= reads ? PyBUF_WRITABLE : PyBUF_SIMPLE;
        if (PyObject_GetBuffer(PyTuple_GetItem(args, i), &held[i], flags))
            return i;
    }
    return wanted;
}

/* Counts in a buffer; false with an error set if it holds none, or lacks one of the pixels. */
static int light_of(const Py_buffer *held, const Py_buffer *which, Light *light)
{
    char type = held->format ? held->format[0] : 0;
    if (held->ndim != 2 || (type != 'H' && type != 'I' && type != 'f')) {
        PyErr_SetString(PyExc_ValueError,
                        "counts must be (pixel, bin) of uint16, uint32 or float32");
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

/* What a call from Python holds while it runs. */
typedef struct {
    int count; /* of buffers that are held */
    Py_buffer held[MOST_BUFFERS];
    Light light;
    const int64_t *which;
    size_t pixels;
    char *block; /* of scratch memory */
} Call;

static int begin(Call *call, PyObject *args, int wanted, int reads)
{
    const Py_buffer *held = call->held;
    call->count = hold(args, call->held, wanted, reads, COUNTS_GIVEN);
    if (call->count < wanted || !light_of(&held[COUNTS_GIVEN], &held[PIXELS_GIVEN], &call->light))
        return 0;
    call->which = held[PIXELS_GIVEN].buf;
    call->pixels = (size_t)held[PIXELS_GIVEN].len / 8;
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

/* Tables from the arguments; false if they do not fit counts of so many bins. */
static int read_tables(const Call *call, Py_ssize_t bins, ModelTables *tables)
{
    const Py_buffer *held = call->held;
    *tables = (ModelTables){0};
    if (held[FIT_SIZES].len != sizeof(TableSizes) || held[FIT_RULES].len != sizeof(FitRules))
        return 0;
    make_tables(held, tables);
    return tables->bands >= 1 && tables->bands <= MOST_BANDS && tables->rules.nodes >= 1
        && tables->rules.nodes <= MOST_NODES && bins == tables->bins;
}

static int run_fit(Call *call)
{
    const Py_buffer *held = call->held;
    ModelTables tables;
    int fits = read_tables(call, held[COUNTS_GIVEN].shape[1], &tables);
    size_t each = 8 * (size_t)tables.bands, contrasts = (size_t)tables.rules.contrasts;
    if (!fits || (held[FIT_RATES].len && !holds(call, FIT_RATES, 4))
        || !holds(call, FIT_OFFSETS, 4) || !holds(call, FIT_DELAY_NS, 8)
        || !holds(call, FIT_DELAY_STD_NS, 8) || !holds(call, FIT_OTHER_NS, 8)
        || !holds(call, FIT_AMPLITUDES, each) || !holds(call, FIT_AMPLITUDE_STD, each)
        || !holds(call, FIT_BACKGROUND, 8) || !holds(call, FIT_DETECTION, 8)
        || !holds(call, FIT_CHI_SQUARE, 8) || !holds(call, FIT_MISFIT, 8)
        || (size_t)held[FIT_CONTRASTS].len != 4 * contrasts * (size_t)tables.bands
        || (size_t)held[FIT_CURVATURES].len != 4 * (size_t)tables.bands
        || tables.rules.points < 2 || held[FIT_MOMENTS].len != 8 * tables.rules.points
        || contrasts > 2 || !holds(call, FIT_STEPS, 1))
        return refuse("fit: buffers do not fit one another");
    Results results = {
        .delay = held[FIT_DELAY_NS].buf, .deviation = held[FIT_DELAY_STD_NS].buf,
        .other = held[FIT_OTHER_NS].buf, .amplitudes = held[FIT_AMPLITUDES].buf,
        .amplitude_std = held[FIT_AMPLITUDE_STD].buf, .background = held[FIT_BACKGROUND].buf,
        .detection = held[FIT_DETECTION].buf,
        .chi_square = held[FIT_CHI_SQUARE].buf, .misfit = held[FIT_MISFIT].buf,
        .steps = held[FIT_STEPS].buf,
    };
    AssessmentTables tests = {held[FIT_CONTRASTS].buf, held[FIT_CURVATURES].buf,
                              held[FIT_MOMENTS].buf};
    Scratch scratch;
    int together = call->pixels < CHUNK ? (int)call->pixels : CHUNK;
    int kept = kept_apart(&tables, &call->light, held[FIT_RATES].len > 0);
    call->block = make_scratch(&tables, together, kept, &scratch);
    if (!allocated(call))
        return 0;
    Py_BEGIN_ALLOW_THREADS
    fit_pixels(&tables, &call->light, call->which, call->pixels, held[FIT_OFFSETS].buf,
               held[FIT_RATES].len ? held[FIT_RATES].buf : NULL, &tests, &results,
               &scratch);
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_fit(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, FIT_BUFFERS, FIT_READS) && run_fit(&call));
}

static int run_change_reference(Call *call)
{
    const Py_buffer *held = call->held;
    ModelTables tables;
    int fits = read_tables(call, held[COUNTS_GIVEN].shape[1], &tables);
    size_t bands = (size_t)tables.bands, room = weight_room(&tables), sums = contrast_sums(&tables);
    if (!fits || !holds(call, CHANGE_REFERENCE_DELAYS, 4)
        || !holds(call, CHANGE_REFERENCE_AMPLITUDES, 4 * bands)
        || !holds(call, CHANGE_REFERENCE_BACKGROUND, 4)
        || !holds(call, CHANGE_REFERENCE_WEIGHTS, room)
        || !holds(call, CHANGE_REFERENCE_SUMS, 4 * sums))
        return refuse("change_reference: buffers do not fit one another");
    Scratch scratch;
    call->block = make_scratch(&tables, 1, 1, &scratch);
    if (!allocated(call))
        return 0;
    const float *delays = held[CHANGE_REFERENCE_DELAYS].buf;
    const float *amplitudes = held[CHANGE_REFERENCE_AMPLITUDES].buf;
    const float *background = held[CHANGE_REFERENCE_BACKGROUND].buf;
    int8_t *weights = held[CHANGE_REFERENCE_WEIGHTS].buf;
    float *made = held[CHANGE_REFERENCE_SUMS].buf;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i++) {
        const float *counts = wide_counts(&tables, &call->light, (size_t)call->which[i], &scratch);
        change_reference(&tables, counts, delays[i], amplitudes + i * bands, background[i],
                         scratch.work, weights + i * room, made + i * sums);
    }
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_change_reference(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, CHANGE_REFERENCE_BUFFERS, CHANGE_REFERENCE_READS)
                          && run_change_reference(&call));
}

/* The part of counts that is light, in time order; false if it does not fit the tables. */
static int light_within(const Call *call, ModelTables *tables, Light *light)
{
    const int64_t *span = call->held[CHANGES_SPAN].buf;
    *light = call->light;
    if (call->held[CHANGES_SPAN].len != 24 || span[0] < 0 || span[1] <= span[0]
        || span[1] > call->held[COUNTS_GIVEN].shape[1]
        || !read_tables(call, span[1] - span[0], tables))
        return 0;
    light->data += (span[2] ? span[1] - 1 : span[0]) * light->bin_step;
    light->bin_step *= span[2] ? -1 : 1;
    return 1;
}

static int run_changes(Call *call)
{
    const Py_buffer *held = call->held;
    ModelTables tables;
    Light light;
    int fits = light_within(call, &tables, &light);
    size_t room = weight_room(&tables), sums = contrast_sums(&tables);
    size_t pixels = (size_t)call->light.pixels;
    if (!fits || !holds(call, CHANGES_ALL, 8) || !holds(call, CHANGES_INSIDE, 8)
        || !holds(call, CHANGES_FULL, 1) || !holds(call, CHANGES_SIGNIFICANCE, 4)
        || (held[CHANGES_EXPOSURES].len && (size_t)held[CHANGES_EXPOSURES].len < 8 * pixels)
        || (held[CHANGES_EARLIER].len && (size_t)held[CHANGES_EARLIER].len < 8 * pixels)
        || (size_t)held[CHANGES_DELAYS].len < 4 * pixels
        || (size_t)held[CHANGES_WEIGHTS].len < room * pixels
        || (size_t)held[CHANGES_KEPT].len < 4 * sums * pixels)
        return refuse("changes: buffers do not fit one another");
    Scratch scratch;
    call->block = make_scratch(&tables, 1, 1, &scratch);
    if (!allocated(call))
        return 0;
    const int64_t *span = held[CHANGES_SPAN].buf;
    const double *exposures = held[CHANGES_EXPOSURES].len ? held[CHANGES_EXPOSURES].buf : NULL;
    const double *earlier = held[CHANGES_EARLIER].len ? held[CHANGES_EARLIER].buf : NULL;
    const float *delays = held[CHANGES_DELAYS].buf, *kept = held[CHANGES_KEPT].buf;
    const int8_t *weights = held[CHANGES_WEIGHTS].buf;
    double *all = held[CHANGES_ALL].buf, *inside = held[CHANGES_INSIDE].buf;
    uint8_t *full = held[CHANGES_FULL].buf;
    float *results = held[CHANGES_SIGNIFICANCE].buf;
    int bins = (int)held[COUNTS_GIVEN].shape[1];
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i++) {
        size_t pixel = (size_t)call->which[i];
        if (i + 4 < call->pixels)
            fetch_row(&call->light, row_of(&call->light, (size_t)call->which[i + 4]), bins);
        sum_counts(&call->light, pixel, bins, (int)span[0], (int)span[1], all + i, inside + i,
                   full + i);
        double now = exposures ? exposures[pixel] : all[i];
        const float *counts = wide_counts(&tables, &light, pixel, &scratch);
        results[i] = change_significance(&tables, counts, weights + pixel * room,
                                         kept + pixel * sums,
                                         earlier ? (float)(now / earlier[pixel]) : 1, delays[pixel],
                                         scratch.work);
    }
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_changes(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, CHANGES_BUFFERS, CHANGES_READS) && run_changes(&call));
}

enum { FETCHED_AHEAD = 7 << 10 }; /* bytes of counts before those that are summed */

static int run_sums(Call *call)
{
    const Py_buffer *held = call->held;
    int bins = (int)held[COUNTS_GIVEN].shape[1];
    const int64_t *span = held[SUMS_SPAN].buf;
    if (held[SUMS_SPAN].len != 16 || span[0] < 0 || span[1] < span[0] || span[1] > bins
        || !holds(call, SUMS_ALL, 8) || !holds(call, SUMS_INSIDE, 8) || !holds(call, SUMS_FULL, 1))
        return refuse("sums: buffers do not fit one another");
    double *all = held[SUMS_ALL].buf, *inside = held[SUMS_INSIDE].buf;
    uint8_t *full = held[SUMS_FULL].buf;
    size_t ahead = 1 + FETCHED_AHEAD / (size_t)(bins * (call->light.type == 'H' ? 2 : 4) + 1);
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i++) {
        if (i + ahead < call->pixels)
            fetch_row(&call->light, row_of(&call->light, (size_t)call->which[i + ahead]), bins);
        sum_counts(&call->light, (size_t)call->which[i], bins, (int)span[0], (int)span[1], all + i,
                   inside + i, full + i);
    }
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_sums(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, SUMS_BUFFERS, SUMS_READS) && run_sums(&call));
}

/* What all pixels of a call share; false if its buffers do not fit one another. */
static int make_paper(const Call *call, Paper *paper)
{
    const Py_buffer *held = call->held;
    const CorrelationSizes *sizes = held[CORRELATIONS_SIZES].buf;
    if (held[CORRELATIONS_SIZES].len != sizeof *sizes)
        return 0;
    *paper = (Paper){
        .bins = (int)held[COUNTS_GIVEN].shape[1], .search = sizes->search, .reach = sizes->reach,
        .most = sizes->most, .highest = (int)sizes->highest, .circular = sizes->circular,
        .bands = sizes->bands, .outside = sizes->outside, .half_width = sizes->half_width,
        .windows = (int)(held[CORRELATIONS_WINDOWS].len / 12),
        .window = held[CORRELATIONS_WINDOWS].buf,
        .gaps = (int)(held[CORRELATIONS_GAPS].len / 8), .gap = held[CORRELATIONS_GAPS].buf,
        .references = held[CORRELATIONS_REFERENCE].buf,
        .pixel_delays = held[CORRELATIONS_PIXEL_DELAYS].buf,
    };
    size_t pixels = (size_t)call->light.pixels;
    int fits = call->light.type != 'f' && paper->search >= 0 && paper->reach >= 0
            && paper->reach <= paper->search && paper->most >= paper->search + paper->reach
            && paper->most <= 2 * paper->bins && paper->reach <= paper->bins
            && paper->half_width <= paper->most && paper->bands > 0
            && (size_t)held[CORRELATIONS_REFERENCE].len / 2
                   >= (size_t)(paper->bins + 2 * paper->most) * pixels
            && (size_t)held[CORRELATIONS_PIXEL_DELAYS].len >= 8 * pixels
            && holds(call, CORRELATIONS_DELAY, 8) && holds(call, CORRELATIONS_DEVIATION, 8)
            && holds(call, CORRELATIONS_BACKGROUND, 8)
            && holds(call, CORRELATIONS_WINDOW_SUMS, 8 * (size_t)paper->bands);
    for (int w = 0; fits && w < paper->windows; w++)
        fits = paper->window[3 * w] >= 0 && paper->window[3 * w] < paper->bands;
    for (int g = 0; fits && g < 2 * paper->gaps; g++)
        fits = paper->gap[g] >= 0 && paper->gap[g] <= paper->bins;
    return fits;
}

static int run_correlations(Call *call)
{
    const Py_buffer *held = call->held;
    Paper paper;
    if (!make_paper(call, &paper))
        return refuse("correlations: buffers do not fit one another");
    Group group;
    call->block = calloc(lay_out(&paper, NULL, &group) + 64, 1);
    if (!allocated(call))
        return 0;
    lay_out(&paper, (char *)(((uintptr_t)call->block + 63) / 64 * 64), &group);
    PaperResults results = {
        .delay = held[CORRELATIONS_DELAY].buf, .deviation = held[CORRELATIONS_DEVIATION].buf,
        .sums = held[CORRELATIONS_WINDOW_SUMS].buf,
        .background = held[CORRELATIONS_BACKGROUND].buf,
    };
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < call->pixels; i += LANES)
        correlate_group(&paper, &group, &call->light, call->which, i, call->pixels, &results);
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_correlations(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin(&call, args, CORRELATIONS_BUFFERS, CORRELATIONS_READS)
                          && run_correlations(&call));
}

#include "picture_calls.h"

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
    {"processor", py_processor, METH_NOARGS, "Number of faster builds that this processor runs."},
    {"sums", py_sums, METH_VARARGS, "Counts of pixels."},
    {"fit", py_fit, METH_VARARGS, "Joint fit of pixels."},
    {"change_reference", py_change_reference, METH_VARARGS, "What later counts are compared with."},
    {"changes", py_changes, METH_VARARGS, "Counts of pixels, and how much they have changed."},
    {"correlations", py_correlations, METH_VARARGS, "The published method."},
    {"verdicts", py_verdicts, METH_VARARGS, "Flags of fits."},
    {"picture", py_picture, METH_VARARGS, "Results of pixels at their places in a picture."},
    {"surface_starts", py_surface_starts, METH_VARARGS, "Surfaces about pixels."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, TEXT(MODULE), "The joint fit in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC INIT(MODULE)(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made && (PyModule_AddIntConstant(made, "LANES", LANES)
                 || PyModule_AddStringConstant(made, "ABI", ABI))) {
        Py_DECREF(made);
        return NULL;
    }
    return made;
}
