/* Few photons: the loops over photons and over neighbours. `pooling` holds the same in NumPy. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define EVERY_WIDTH __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_WIDTH
#endif

enum { MOST_PLANES = 40, MOST_GROUPS = 8, LANES = 16 };

#define INLINE static inline __attribute__((always_inline))

/* Sixteen pixels side by side, in the compiler's own vector types. */
typedef float vec __attribute__((vector_size(64)));
typedef float loose __attribute__((vector_size(64), aligned(4)));  /* wherever it lies */
typedef int32_t ivec __attribute__((vector_size(64)));

INLINE vec load(const float *from) { return *(const loose *)from; }
INLINE vec fill(float x) { return x - (vec){0}; }
INLINE vec choose(ivec mask, vec yes, vec no)
{
    return (vec)((mask & (ivec)yes) | (~mask & (ivec)no));
}
INLINE vec greater(vec a, vec b) { return choose(a > b, a, b); }

/* -- photons -------------------------------------------------------------------------------- */

/* Entries of one pixel's histogram that are not 0 and have a time; written where there is room. */
#define LIST(NAME, TYPE, WORDS)                                                                   \
    static int64_t NAME(const TYPE *counts, int64_t codes, const float *times, float later,       \
                        float period, float *time, float *weight)                                 \
    {                                                                                             \
        int64_t found = 0;                                                                        \
        for (int64_t code = 0; code < codes; code += WORDS) {                                     \
            if (code + WORDS <= codes) {                                                          \
                uint64_t bits[4];                                                                 \
                memcpy(bits, counts + code, 32);                                                  \
                if (!(bits[0] | bits[1] | bits[2] | bits[3]))                                     \
                    continue;                                                                     \
            }                                                                                     \
            int64_t end = code + WORDS < codes ? code + WORDS : codes;                            \
            for (int64_t here = code; here < end; here++) {                                       \
                if (!counts[here] || !(times[here] >= 0))                                         \
                    continue;                                                                     \
                if (time) {                                                                       \
                    float t = times[here] - later;                                                \
                    t -= floorf(t / period) * period;                                             \
                    time[found] = t < period ? t : 0;                                             \
                    weight[found] = (float)counts[here];                                          \
                }                                                                                 \
                found++;                                                                          \
            }                                                                                     \
        }                                                                                         \
        return found;                                                                             \
    }

LIST(list_u16, uint16_t, 16)
LIST(list_u32, uint32_t, 8)
LIST(list_f32, float, 8)

static int64_t list_pixel(char type, const char *counts, int64_t codes, const float *times,
                          float later, float period, float *time, float *weight)
{
    if (type == 'H')
        return list_u16((const uint16_t *)counts, codes, times, later, period, time, weight);
    if (type == 'I')
        return list_u32((const uint32_t *)counts, codes, times, later, period, time, weight);
    return list_f32((const float *)counts, codes, times, later, period, time, weight);
}

typedef struct {
    int64_t pixels;
    const int64_t *starts;
    const float *times, *weights;
} Photons;

static int cell_of(float time, float delay, float cells_per_ns, int cells)
{
    int cell = (int)floorf((time - delay) * cells_per_ns);
    cell %= cells;
    return cell < 0 ? cell + cells : cell;
}

/* Log-likelihood of every lag, in whole cells of the table. */
static void lag_likelihood(const Photons *seen, const float *table, int cells, float cells_per_ns,
                           const int32_t *lags, int count, float *result)
{
    for (int64_t p = 0; p < seen->pixels; p++) {
        float *here = result + p * count;
        memset(here, 0, sizeof(float) * (size_t)count);
        for (int64_t i = seen->starts[p]; i < seen->starts[p + 1]; i++) {
            int cell = cell_of(seen->times[i], 0, cells_per_ns, cells);
            for (int l = 0; l < count; l++) {
                int at = cell - lags[l];
                at += at < 0 ? cells : 0;
                at -= at >= cells ? cells : 0;
                here[l] += seen->weights[i] * table[at];
            }
        }
    }
}

/* Photons in the slots of a delay, (slot, pixel). */
static void slots(const Photons *seen, const float *delays, const int8_t *owners, int cells,
                  float cells_per_ns, int count, float *result)
{
    memset(result, 0, sizeof(float) * (size_t)(seen->pixels * count));
    for (int64_t p = 0; p < seen->pixels; p++)
        for (int64_t i = seen->starts[p]; i < seen->starts[p + 1]; i++) {
            int cell = cell_of(seen->times[i], delays[p], cells_per_ns, cells);
            result[owners[cell] * seen->pixels + p] += seen->weights[i];
        }
}

/* Derivative of the log-likelihood by the delay and its square's sum, the information. */
static void scores(const Photons *seen, const float *delays, const float *shares,
                   const float *slopes, int cells, float cells_per_ns, int bands,
                   const float *amplitudes, const float *floors, float *score, float *information)
{
    for (int64_t p = 0; p < seen->pixels; p++) {
        const float *a = amplitudes + p * bands;
        float first = 0, second = 0;
        for (int64_t i = seen->starts[p]; i < seen->starts[p + 1]; i++) {
            size_t cell = (size_t)cell_of(seen->times[i], delays[p], cells_per_ns, cells);
            const float *share = shares + cell * (size_t)bands;
            const float *slope = slopes + cell * (size_t)bands;
            float rate = floors[p], change = 0;
            for (int k = 0; k < bands; k++) {
                rate += a[k] * share[k];
                change -= a[k] * slope[k];
            }
            float g = change / rate;
            first += seen->weights[i] * g;
            second += seen->weights[i] * g * g;
        }
        score[p] = first;
        information[p] = second;
    }
}

/* -- neighbours ----------------------------------------------------------------------------- */

typedef struct {
    int rows, cols, rim, groups, planes, spectral;
    int64_t stride;          /* of padded rows */
    int64_t plane;           /* padded floats per plane */
    const float *roots;      /* (group, row, col) padded: √ of pooled counts per pixel */
    const float *delays;     /* padded */
    const float *valid;      /* padded: 1 or 0 */
    const float *data;       /* (plane, row, col) padded: what is pooled */
    const float *trust;      /* (row, col): twice the pixels pooled so far */
    const float *information;/* (row, col): half the information on the delay so far */
    const uint8_t *active;   /* (row, col) */
    float colour_limit, depth_colour_limit, depth_limit;
} Pool;

/* One row: weights of all neighbours, sums of their data. `places` are (row step, column step),
 * `kernel` how much each counts by distance. Results are (plane + 3, rows · cols). With `groups`,
 * `planes` and `spectral` known to the compiler all sums stay in registers. */
INLINE void pool_row(const Pool *pool, int row, const int32_t *places, const float *kernel,
                     int count, float *result, int groups, int planes, int spectral)
{
    int cols = pool->cols;
    int64_t size = (int64_t)pool->rows * cols;
    vec one = fill(1), none = {0};
    for (int col = 0; col < cols; col += LANES) {
        int last = col + LANES <= cols ? LANES : cols - col;
        int busy = 0;
        float wide[2][LANES] = {{0}};
        for (int lane = 0; lane < last; lane++) {
            int64_t at = (int64_t)row * cols + col + lane;
            busy |= pool->active[at];
            wide[0][lane] = pool->trust[at];
            wide[1][lane] = pool->information[at];
        }
        if (!busy)
            continue;
        vec trust = load(wide[0]), information = load(wide[1]);
        int64_t here = (int64_t)(row + pool->rim) * pool->stride + col + pool->rim;
        vec root[MOST_GROUPS], sums[MOST_PLANES];
        for (int g = 0; g < groups; g++)
            root[g] = load(pool->roots + g * pool->plane + here);
        for (int m = 0; m < planes; m++)
            sums[m] = none;
        vec delay = load(pool->delays + here);
        vec total = none, squares = none, depth_squares = none;
        for (int n = 0; n < count; n++) {
            int64_t there = here + places[2 * n] * pool->stride + places[2 * n + 1];
            vec apart = none;
            for (int g = 0; g < groups; g++) {
                vec step = load(pool->roots + g * pool->plane + there) - root[g];
                apart += step * step;
            }
            apart *= trust;
            vec move = load(pool->delays + there) - delay;
            move = move * move * information * pool->depth_limit;
            vec most = load(pool->valid + there) * kernel[n];
            vec rest = 2.0f * (one - apart * pool->colour_limit - move);
            vec w = most * choose(rest > one, one, greater(rest, none));
            rest = 2.0f * (one - apart * pool->depth_colour_limit - move);
            vec d = most * choose(rest > one, one, greater(rest, none));
            total += w;
            squares += w * w;
            depth_squares += d * d;
            for (int m = 0; m < spectral; m++)
                sums[m] += w * load(pool->data + m * pool->plane + there);
            for (int m = spectral; m < planes; m++)
                sums[m] += d * load(pool->data + m * pool->plane + there);
        }
        float *to = result + (int64_t)row * cols + col;
        size_t bytes = sizeof(float) * (size_t)last;
        for (int m = 0; m < planes; m++)
            memcpy(to + m * size, &sums[m], bytes);
        memcpy(to + planes * size, &total, bytes);
        memcpy(to + (planes + 1) * size, &squares, bytes);
        memcpy(to + (planes + 2) * size, &depth_squares, bytes);
    }
}

EVERY_WIDTH
static void pool_rows(const Pool *pool, int first, int last, const int32_t *places,
                      const float *kernel, int count, float *result)
{
    int groups = pool->groups, planes = pool->planes, spectral = pool->spectral;
    int plain = groups == 3 && planes == spectral + 3;
    for (int row = first; row < last; row++) {
        if (plain && spectral == 10) /* nine bands and the background, and depth */
            pool_row(pool, row, places, kernel, count, result, 3, 13, 10);
        else if (plain && spectral == 0) /* depth alone */
            pool_row(pool, row, places, kernel, count, result, 3, 3, 0);
        else
            pool_row(pool, row, places, kernel, count, result, groups, planes, spectral);
    }
}

/* -- Python --------------------------------------------------------------------------------- */

/* Hold so many buffers, those from `writable` on to be written; 0 if one is not to be had. */
static int hold(PyObject *args, Py_ssize_t count, Py_ssize_t writable, Py_buffer *held)
{
    if (PyTuple_Size(args) != count) {
        PyErr_Format(PyExc_TypeError, "%zd buffers are needed", count);
        return 0;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (i >= writable ? PyBUF_WRITABLE : 0);
        if (PyObject_GetBuffer(PyTuple_GetItem(args, i), &held[i], flags)) {
            while (i--)
                PyBuffer_Release(&held[i]);
            return 0;
        }
    }
    return 1;
}

static PyObject *finish(Py_buffer *held, Py_ssize_t count, int fits)
{
    while (count--)
        PyBuffer_Release(&held[count]);
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "buffers do not fit one another");
        return NULL;
    }
    Py_INCREF(Py_None);
    return Py_None;
}

static int64_t items(const Py_buffer *held, size_t size) { return held->len / (int64_t)size; }

/* list(counts, times, later, reals: period; starts, time, weight): pixels whose entries have no
 * room left are counted only, so that starts tells how much room is needed. */
static PyObject *py_list(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[7];
    if (!hold(args, 7, 4, held))
        return NULL;
    char type = held[0].format ? held[0].format[0] : 0;
    int64_t codes = items(&held[1], 4), pixels = items(&held[2], 4), room = items(&held[5], 4);
    int fits = (type == 'H' || type == 'I' || type == 'f') && items(&held[3], 4) == 1
            && items(&held[0], (size_t)held[0].itemsize) == codes * pixels
            && items(&held[4], 8) == pixels + 1 && room == items(&held[6], 4);
    if (fits) {
        const char *counts = held[0].buf;
        int64_t *starts = held[4].buf, row = codes * held[0].itemsize;
        float period = *(const float *)held[3].buf, *time = held[5].buf, *weight = held[6].buf;
        const float *later = held[2].buf;
        starts[0] = 0;
        Py_BEGIN_ALLOW_THREADS
        for (int64_t p = 0; p < pixels; p++) {
            int written = starts[p] + codes <= room;
            starts[p + 1] = starts[p]
                          + list_pixel(type, counts + p * row, codes, held[1].buf, later[p], period,
                                       written ? time + starts[p] : NULL,
                                       written ? weight + starts[p] : NULL);
        }
        Py_END_ALLOW_THREADS
    }
    return finish(held, 7, fits);
}

/* A call of a loop over photons: starts, times and weights come first among the buffers. */
typedef struct {
    Py_buffer held[11];
    Photons seen;
} Call;

static int64_t floats(const Call *call, int place) { return items(&call->held[place], 4); }

static int each(const Call *call, int place) /* pixel's floats in a buffer */
{
    return call->seen.pixels > 0 ? (int)(floats(call, place) / call->seen.pixels) : 0;
}

/* Run a loop over photons without the interpreter's lock, if its buffers fit one another. */
static PyObject *over_photons(PyObject *args, Py_ssize_t count, Py_ssize_t writable,
                              int (*check)(const Call *), void (*loop)(const Call *))
{
    Call call;
    if (!hold(args, count, writable, call.held))
        return NULL;
    const Py_buffer *held = call.held;
    call.seen = (Photons){items(&held[0], 8) - 1, held[0].buf, held[1].buf, held[2].buf};
    int fits = call.seen.pixels >= 0 && floats(&call, 1) == floats(&call, 2)
            && call.seen.starts[call.seen.pixels] <= floats(&call, 1) && check(&call);
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        loop(&call);
        Py_END_ALLOW_THREADS
    }
    return finish(call.held, count, fits);
}

/* lags(starts, time, weight, table, reals: cells per ns, lags; result) */
static int lags_fit(const Call *call)
{
    int64_t cells = floats(call, 3), count = floats(call, 5);
    const int32_t *lags = call->held[5].buf;
    int fits = floats(call, 4) == 1 && floats(call, 6) == call->seen.pixels * count;
    for (int l = 0; fits && l < count; l++)
        fits = lags[l] > -cells && lags[l] < cells;
    return fits;
}

static void run_lags(const Call *call)
{
    const Py_buffer *held = call->held;
    lag_likelihood(&call->seen, held[3].buf, (int)floats(call, 3), *(const float *)held[4].buf,
                   held[5].buf, (int)floats(call, 5), held[6].buf);
}

static PyObject *py_lags(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, 7, 6, lags_fit, run_lags);
}

/* slots(starts, time, weight, delays, owners, reals: cells per ns; result) */
static int slots_fit(const Call *call)
{
    int64_t cells = items(&call->held[4], 1);
    const int8_t *owners = call->held[4].buf;
    int fits = floats(call, 3) == call->seen.pixels && floats(call, 5) == 1;
    for (int64_t cell = 0; fits && cell < cells; cell++)
        fits = owners[cell] >= 0 && owners[cell] < each(call, 6);
    return fits;
}

static void run_slots(const Call *call)
{
    const Py_buffer *held = call->held;
    slots(&call->seen, held[3].buf, held[4].buf, (int)items(&held[4], 1),
          *(const float *)held[5].buf, each(call, 6), held[6].buf);
}

static PyObject *py_slots(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, 7, 6, slots_fit, run_slots);
}

/* scores(starts, time, weight, delays, shares, slopes, amplitudes, floors, reals: cells per ns;
 * score, information) */
static int scores_fit(const Call *call)
{
    int64_t pixels = call->seen.pixels;
    return each(call, 6) > 0 && floats(call, 3) == pixels && floats(call, 4) == floats(call, 5)
        && floats(call, 7) == pixels && floats(call, 8) == 1 && floats(call, 9) == pixels
        && floats(call, 10) == pixels;
}

static void run_scores(const Call *call)
{
    const Py_buffer *held = call->held;
    int bands = each(call, 6);
    scores(&call->seen, held[3].buf, held[4].buf, held[5].buf, (int)(floats(call, 4) / bands),
           *(const float *)held[8].buf, bands, held[6].buf, held[7].buf, held[9].buf,
           held[10].buf);
}

static PyObject *py_scores(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, 11, 9, scores_fit, run_scores);
}

/* pool(integers: first row, last row, rows, cols, rim, groups, planes, spectral; reals: limits of
 * colour, colour for depth, depth, each inverted; places, kernel, roots, delays, valid, data,
 * trust, information, active; result) */
static PyObject *py_pool(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[12];
    if (!hold(args, 12, 11, held))
        return NULL;
    const int32_t *n = held[0].buf, *places = held[2].buf;
    const float *x = held[1].buf;
    int fits = items(&held[0], 4) == 8 && items(&held[1], 4) == 3;
    Pool pool = {0};
    int count = (int)items(&held[3], 4);
    if (fits) {
        int64_t size = (int64_t)n[2] * n[3];
        int64_t stride = n[3] + 2 * n[4] + LANES;
        pool = (Pool){.rows = n[2], .cols = n[3], .rim = n[4], .groups = n[5], .planes = n[6],
                      .spectral = n[7], .stride = stride, .plane = stride * (n[2] + 2 * n[4]),
                      .roots = held[4].buf, .delays = held[5].buf, .valid = held[6].buf,
                      .data = held[7].buf, .trust = held[8].buf, .information = held[9].buf,
                      .active = held[10].buf, .colour_limit = x[0], .depth_colour_limit = x[1],
                      .depth_limit = x[2]};
        fits = n[0] >= 0 && n[0] <= n[1] && n[1] <= n[2] && n[3] > 0 && n[4] >= 0 && n[5] >= 1
            && n[5] <= MOST_GROUPS && n[6] >= 1 && n[6] <= MOST_PLANES && n[7] >= 0 && n[7] <= n[6]
            && items(&held[2], 4) == 2 * (int64_t)count
            && items(&held[4], 4) == pool.plane * n[5] && items(&held[5], 4) == pool.plane
            && items(&held[6], 4) == pool.plane && items(&held[7], 4) == pool.plane * n[6]
            && items(&held[8], 4) == size && items(&held[9], 4) == size
            && items(&held[10], 1) == size && items(&held[11], 4) == size * (n[6] + 3);
    }
    for (int i = 0; fits && i < 2 * count; i++)
        fits = places[i] >= -pool.rim && places[i] <= pool.rim;
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        pool_rows(&pool, n[0], n[1], places, held[3].buf, count, held[11].buf);
        Py_END_ALLOW_THREADS
    }
    return finish(held, 12, fits);
}

static PyMethodDef methods[] = {
    {"list", py_list, METH_VARARGS, "Photons of pixels."},
    {"lags", py_lags, METH_VARARGS, "Log-likelihood of lags."},
    {"slots", py_slots, METH_VARARGS, "Photons in the slots of a delay."},
    {"scores", py_scores, METH_VARARGS, "Score and information of the delay."},
    {"pool", py_pool, METH_VARARGS, "Weighted sums over neighbours."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernels", "Few photons, in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModule_Create(&module); }
