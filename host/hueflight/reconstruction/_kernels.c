/* The joint fit in C: the extension module. fit.py is its definition and its oracle.
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

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define EVERY_WIDTH __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_WIDTH
#endif

/* Where counts lie, and of which type: 'H', 'I' or 'f'. */
typedef struct {
    const char *data;
    Py_ssize_t pixels, pixel_step, bin_step;
    char type;
} Light;

typedef struct {
    float *delay, *deviation, *other, *amplitudes, *amplitude_std, *background;
    uint8_t *steps;
} Results;

typedef struct {
    float *fine, *half, *coarse, *sensor, *scores;
    int8_t *tried;
    size_t fine_stride, half_stride;
    Equations *equations;
    Track *tracks;
} Scratch;

/* Counts of one pixel as floats, in the sensor's bins. */
INLINE void read_counts(const Light *light, size_t pixel, int bins, float *to)
{
    const char *from = light->data + (Py_ssize_t)pixel * light->pixel_step;
    Py_ssize_t by = light->bin_step;
    if (light->type == 'H' && by == 2)
        for (int i = 0; i < bins; i++)
            to[i] = (float)((const uint16_t *)from)[i];
    else if (light->type == 'H' && by == -2)
        for (int i = 0; i < bins; i++)
            to[i] = (float)((const uint16_t *)from)[-i];
    else if (light->type == 'H')
        for (int i = 0; i < bins; i++)
            to[i] = (float)*(const uint16_t *)(from + i * by);
    else if (light->type == 'I' && by == -4)
        for (int i = 0; i < bins; i++)
            to[i] = (float)((const uint32_t *)from)[-i];
    else if (light->type == 'I' && by == 4)
        for (int i = 0; i < bins; i++)
            to[i] = (float)((const uint32_t *)from)[i];
    else if (light->type == 'I')
        for (int i = 0; i < bins; i++)
            to[i] = (float)*(const uint32_t *)(from + i * by);
    else if (by == 4)
        memcpy(to, from, (size_t)bins * sizeof *to);
    else if (by == -4)
        for (int i = 0; i < bins; i++)
            to[i] = ((const float *)from)[-i];
    else
        for (int i = 0; i < bins; i++)
            to[i] = *(const float *)(from + i * by);
}

/* Sums of `factor` bins each within every view; returns how many. `sizes` may be those of the
 * sensor or, with `before`, of bins that were summed already. */
INLINE int group(const Plan *plan, int before, int factor, const float *from, float *to)
{
    int made = 0;
    for (int v = 0; v < plan->views; v++) {
        int size = (plan->sizes[v] + before - 1) / before, full = size / factor;
        if (factor == 1)
            memcpy(to + made, from, (size_t)size * sizeof *to);
        else if (factor == 2)
            for (int j = 0; j < full; j++)
                to[made + j] = from[2 * j] + from[2 * j + 1];
        else if (factor == 4)
            for (int j = 0; j < full; j++)
                to[made + j] = (from[4 * j] + from[4 * j + 1]) + (from[4 * j + 2] + from[4 * j + 3]);
        else
            for (int j = 0; j < full; j++) {
                float x = 0;
                for (int i = 0; i < factor; i++)
                    x += from[j * factor + i];
                to[made + j] = x;
            }
        if (full * factor < size) {
            float rest = 0;
            for (int i = full * factor; i < size; i++)
                rest += from[i];
            to[made + full] = rest;
        }
        made += (size + factor - 1) / factor;
        from += size;
    }
    return made;
}

/* Steps of scoring at the full bin width until every track has settled. */
INLINE void settle(const Plan *plan, const Scratch *scratch, const float *totals,
                   const float *offsets, Track **tracks, int count)
{
    const Rules *rules = &plan->rules;
    Track *active[TRACKS];
    float moved[LANES];
    if (rules->halves)
        for (int i = 0; i < count; i += LANES)
            step(plan, &plan->half, scratch->half, scratch->half_stride, totals, offsets,
                 tracks + i, count - i < LANES ? count - i : LANES, scratch->equations, moved);
    int left = 0;
    for (int i = 0; i < count; i++)
        if (!rules->halves || sqrtf(tracks[i]->variance) > rules->target_ns)
            active[left++] = tracks[i];
    for (int round = 0; round < rules->steps && left; round++) {
        int kept = 0;
        for (int i = 0; i < left; i += LANES) {
            int some = left - i < LANES ? left - i : LANES;
            step(plan, &plan->fine, scratch->fine, scratch->fine_stride, totals, offsets,
                 active + i, some, scratch->equations, moved);
            for (int lane = 0; lane < some; lane++) {
                Track *track = active[i + lane];
                track->steps++;
                if (!rules->settle || moved[lane] > rules->settled * sqrtf(track->variance))
                    active[kept++] = track;
            }
        }
        left = kept;
    }
}

/* Between a pixel's two tracks: the likelier is kept, the other told if it is nearly as likely. */
INLINE void decide(const Plan *plan, const float *counts, float total, Track *mine,
                   const Track *rival, float *other)
{
    double lead = best_likelihood(plan, counts, total, mine)
                - best_likelihood(plan, counts, total, rival);
    if (fabsf(mine->delay - rival->delay) <= 3 * sqrtf(mine->variance))
        return; /* both found the same maximum */
    int close = fabs(lead) < (double)plan->rules.ambiguous;
    float loser = lead < 0 ? mine->delay : rival->delay;
    if (lead < 0) {
        int steps = mine->steps;
        *mine = *rival;
        mine->steps = steps;
    }
    if (close)
        *other = loser;
}

INLINE void fit_tile(const Plan *plan, const Light *light, const float *offsets, size_t first,
                     int count, const Results *results, const Scratch *scratch)
{
    const Rules *rules = &plan->rules;
    float totals[TILE], local[TILE], others[TILE];
    Track *tracks[TRACKS];
    int rivals[TILE], made = count;
    for (int p = 0; p < count; p++) {
        float *fine = scratch->fine + (size_t)p * scratch->fine_stride;
        float *half = scratch->half + (size_t)p * scratch->half_stride;
        local[p] = offsets[first + (size_t)p];
        others[p] = NAN;
        rivals[p] = -1;
        if (plan->factor == 1)
            read_counts(light, first + (size_t)p, plan->bins, fine);
        else {
            read_counts(light, first + (size_t)p, plan->bins, scratch->sensor);
            group(plan, 1, plan->factor, scratch->sensor, fine);
        }
        group(plan, plan->factor, plan->half.factor, fine, half);
        group(plan, plan->factor, plan->coarse.factor, fine, scratch->coarse);
        vec whole = {0};
        for (int block = 0; block < plan->fine.blocks; block++)
            whole += load(fine + block * LANES);
        totals[p] = sum(whole);
        int best, second;
        search(plan, scratch->coarse, totals[p], local[p], scratch->scores, scratch->tried);
        two_best(&plan->coarse, scratch->scores, &best, &second);
        tracks[p] = scratch->tracks + p;
        tracks[p]->pixel = p;
        start(plan, scratch->coarse, totals[p], scratch->scores, scratch->tried, best, tracks[p]);
        float worse = second < 0 ? INFINITY : scratch->scores[best] - scratch->scores[second];
        if (worse < rules->margin + rules->raster * totals[p]) {
            rivals[p] = made;
            tracks[made] = scratch->tracks + made;
            tracks[made]->pixel = p;
            start(plan, scratch->coarse, totals[p], scratch->scores, scratch->tried, second,
                  tracks[made]);
            made++;
        }
    }
    settle(plan, scratch, totals, local, tracks, made);
    for (int p = 0; p < count; p++) {
        const float *fine = scratch->fine + (size_t)p * scratch->fine_stride;
        Track *track = scratch->tracks + p;
        size_t at = first + (size_t)p;
        if (rivals[p] >= 0)
            decide(plan, fine, totals[p], track, scratch->tracks + rivals[p], &others[p]);
        float variance = track->variance;
        float delay = track->delay + 0.25f * variance * variance * track->cubic;
        if (rules->posterior && variance > rules->spread_ns * rules->spread_ns / rules->few)
            posterior(plan, fine, totals[p], track, &delay, &variance);
        float low = local[p] + rules->low_ns, high = local[p] + rules->high_ns;
        delay = delay < low ? low : delay > high ? high : delay;
        variance *= 1 + (float)(plan->bands + 2) / totals[p];
        results->delay[at] = delay - local[p];
        results->deviation[at] = sqrtf(variance);
        results->other[at] = others[p] - local[p];
        results->background[at] = track->background;
        results->steps[at] = (uint8_t)track->steps;
        for (int k = 0; k < plan->bands; k++) {
            results->amplitudes[at * (size_t)plan->bands + (size_t)k] = track->amplitudes[k];
            results->amplitude_std[at * (size_t)plan->bands + (size_t)k]
                = sqrtf(track->spread[k] + 0.5f);
        }
    }
}

EVERY_WIDTH
static void fit_pixels(const Plan *plan, const Light *light, const float *offsets,
                       const Results *results, const Scratch *scratch)
{
    for (size_t first = 0; first < (size_t)light->pixels; first += TILE) {
        size_t left = (size_t)light->pixels - first;
        fit_tile(plan, light, offsets, first, left < TILE ? (int)left : TILE, results, scratch);
    }
}

/* -- Python --------------------------------------------------------------------------------- */

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
    size_t lags = vectors(plan->coarse.lags);
    scratch->fine_stride = (size_t)plan->fine.blocks * LANES + LANES; /* not a power of two */
    scratch->half_stride = (size_t)plan->half.blocks * LANES + LANES;
    size_t bytes = 64 * 16 + TILE * 4 * (scratch->fine_stride + scratch->half_stride)
                 + 4 * (vectors(plan->coarse.bins) + vectors(plan->bins) + lags) + lags
                 + sizeof(Equations) + TRACKS * sizeof(Track);
    char *block = calloc(bytes, 1);
    if (!block)
        return NULL;
    char *place = (char *)(((uintptr_t)block + 63) / 64 * 64);
    scratch->fine = take(&place, TILE * 4 * scratch->fine_stride);
    scratch->half = take(&place, TILE * 4 * scratch->half_stride);
    scratch->coarse = take(&place, 4 * vectors(plan->coarse.bins));
    scratch->sensor = take(&place, 4 * vectors(plan->bins));
    scratch->scores = take(&place, 4 * lags);
    scratch->tried = take(&place, lags);
    scratch->equations = take(&place, sizeof(Equations));
    scratch->tracks = take(&place, TRACKS * sizeof(Track));
    return block;
}

enum { LIGHT, OFFSETS, INTEGERS, REALS, SIZES, F_WIDTHS, F_PLACES, F_OWNERS, F_DATA, H_WIDTHS,
       H_PLACES, H_OWNERS, H_DATA, C_SPANS, C_GAINS, C_COSTS, C_OWNERS, C_WIDTHS, C_SHARES,
       DELAY, DEVIATION, OTHER, AMPLITUDES, AMPLITUDE_STD, BACKGROUND, STEPS, BUFFERS };

static void make_plan(const Py_buffer *held, Plan *plan)
{
    const int32_t *n = held[INTEGERS].buf;
    const float *x = held[REALS].buf;
    *plan = (Plan){
        .bands = n[0], .views = n[1], .factor = n[2], .bins = n[3], .sizes = held[SIZES].buf,
        .fine = {.factor = 1, .bins = n[4], .blocks = n[5], .phases = n[6], .first_ns = x[0],
                 .phase_ns = x[1], .widths = held[F_WIDTHS].buf, .places = held[F_PLACES].buf,
                 .owners = held[F_OWNERS].buf, .data = held[F_DATA].buf},
        .half = {.factor = n[7], .bins = n[8], .blocks = n[9], .phases = n[10], .first_ns = x[2],
                 .phase_ns = x[3], .widths = held[H_WIDTHS].buf, .places = held[H_PLACES].buf,
                 .owners = held[H_OWNERS].buf, .data = held[H_DATA].buf},
        .coarse = {.factor = n[11], .bins = n[12], .lags = n[13], .separation = n[14],
                   .first_ns = x[4], .step_ns = x[5], .spans = held[C_SPANS].buf,
                   .gains = held[C_GAINS].buf, .costs = held[C_COSTS].buf,
                   .owners = held[C_OWNERS].buf, .widths = held[C_WIDTHS].buf,
                   .shares = held[C_SHARES].buf},
        .rules = {.shares = {x[6], x[7], x[8]}, .logs = {x[9], x[10], x[11]},
                  .steps = n[15], .nodes = n[16], .rounds = n[17], .halves = n[18],
                  .settle = n[19], .posterior = n[20], .settled = x[12],
                  .floor_photons = x[13], .floor_share = x[14], .ridge = x[15],
                  .margin = x[16], .ambiguous = x[17], .few = x[18], .spacing = x[19],
                  .spread_ns = x[20], .low_ns = x[21], .high_ns = x[22], .target_ns = x[23],
                  .raster = x[24]},
    };
}

/* fit(light, offsets, integers, reals, sizes, tables..., results...): see kernels.py. */
static PyObject *py_fit(PyObject *self, PyObject *args)
{
    (void)self;
    if (PyTuple_Size(args) != BUFFERS) {
        PyErr_Format(PyExc_TypeError, "fit takes %d buffers", BUFFERS);
        return NULL;
    }
    Py_buffer held[BUFFERS];
    PyObject *answer = NULL;
    int count = 0;
    for (; count < BUFFERS; count++) {
        int flags = count == LIGHT ? PyBUF_STRIDED_RO | PyBUF_FORMAT
                  : count >= DELAY ? PyBUF_WRITABLE : PyBUF_SIMPLE;
        if (PyObject_GetBuffer(PyTuple_GetItem(args, count), &held[count], flags))
            goto done;
    }
    char type = held[LIGHT].format ? held[LIGHT].format[0] : 0;
    if (held[LIGHT].ndim != 2 || (type != 'H' && type != 'I' && type != 'f')) {
        PyErr_SetString(PyExc_ValueError, "fit: light must be (pixel, bin) of uint16, uint32 or float32");
        goto done;
    }
    Plan plan;
    make_plan(held, &plan);
    Light light = {held[LIGHT].buf, held[LIGHT].shape[0], held[LIGHT].strides[0],
                   held[LIGHT].strides[1], type};
    size_t pixels = (size_t)light.pixels, bands = (size_t)plan.bands;
    if (plan.bands < 1 || plan.bands > MOST_BANDS || held[LIGHT].shape[1] != plan.bins
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
    fit_pixels(&plan, &light, held[OFFSETS].buf, &results, &scratch);
    Py_END_ALLOW_THREADS
    free(block);
    answer = Py_None;
    Py_INCREF(answer);
done:
    while (count--)
        PyBuffer_Release(&held[count]);
    return answer;
}

static PyMethodDef methods[] = {
    {"fit", py_fit, METH_VARARGS, "Joint fit of pixels; see hueflight.reconstruction.kernels."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernels", "The joint fit in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModule_Create(&module); }
