/* SPDX-License-Identifier: Apache-2.0 */
/* The loops over photons and over neighbors of the pooled method; hueflight/reconstruction/pooled/
 * kernels.py defines the same in NumPy. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define EVERY_WIDTH __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_WIDTH
#endif

#include "abi.h"
#include "vector.h" /* after LANES */

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

INLINE int cell_of(float time, float delay, float cells_per_ns, int cells)
{
    int cell = (int)floorf((time - delay) * cells_per_ns);
    if ((unsigned)cell < (unsigned)cells) /* nearly always: a division takes longer */
        return cell;
    cell %= cells;
    return cell < 0 ? cell + cells : cell;
}

/* Log-likelihood of every lag, in whole cells of the table. */
EVERY_WIDTH
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

/* Photons in the window of each band at a delay, (slot, pixel). */
EVERY_WIDTH
static void windows(const Photons *seen, const float *delays, const int8_t *owners, int cells,
                  float cells_per_ns, int count, float *result)
{
    memset(result, 0, sizeof(float) * (size_t)(seen->pixels * count));
    for (int64_t p = 0; p < seen->pixels; p++)
        for (int64_t i = seen->starts[p]; i < seen->starts[p + 1]; i++) {
            int cell = cell_of(seen->times[i], delays[p], cells_per_ns, cells);
            result[owners[cell] * seen->pixels + p] += seen->weights[i];
        }
}

/* Photons of all pixels of a square in the window of each band at the delay of its middle. Photons
 * of pixels that are neighbors in a row follow one another. Result (square, window). */
EVERY_WIDTH
static void squares(const Photons *seen, int rows, int cols, const int64_t *pixels,
                    const int32_t *reach, int64_t count, const float *delays, const int8_t *owners,
                    int cells, float cells_per_ns, int each, float *result)
{
    for (int64_t s = 0; s < count; s++) {
        float *here = result + s * each;
        memset(here, 0, sizeof(float) * (size_t)each);
        int row = (int)(pixels[s] / cols), col = (int)(pixels[s] % cols), r = reach[s];
        int left = col > r ? col - r : 0, right = col + r < cols ? col + r : cols - 1;
        int bottom = row + r < rows ? row + r : rows - 1;
        for (int y = row > r ? row - r : 0; y <= bottom; y++) {
            int64_t end = seen->starts[(int64_t)y * cols + right + 1];
            for (int64_t i = seen->starts[(int64_t)y * cols + left]; i < end; i++)
                here[owners[cell_of(seen->times[i], delays[s], cells_per_ns, cells)]]
                    += seen->weights[i];
        }
    }
}

/* Derivative of the log-likelihood by the delay and its square's sum, the information. */
EVERY_WIDTH
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

/* -- neighbors ----------------------------------------------------------------------------- */

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
    float color_limit, depth_color_limit, depth_limit;
} Pool;

/* One row: weights of all neighbors, sums of their data. `places` are (row step, column step),
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
            vec rest = 2.0f * (one - apart * pool->color_limit - move);
            vec w = most * choose(rest > one, one, greater(rest, none));
            rest = 2.0f * (one - apart * pool->depth_color_limit - move);
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

/* Entries of pixels that do not fit are only counted: starts then tells how much room is needed. */
static PyObject *py_list(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[LIST_BUFFERS];
    if (!hold(args, LIST_BUFFERS, LIST_READS, held))
        return NULL;
    const Py_buffer *given = &held[LIST_COUNTS];
    char type = given->format ? given->format[0] : 0;
    int64_t codes = items(&held[LIST_CODE_TIMES], 4), pixels = items(&held[LIST_PIXEL_DELAYS], 4);
    int64_t room = items(&held[LIST_TIMES], 4);
    int fits = (type == 'H' || type == 'I' || type == 'f')
            && held[LIST_PERIOD].len == sizeof(Period)
            && items(given, (size_t)given->itemsize) == codes * pixels
            && items(&held[LIST_STARTS], 8) == pixels + 1 && room == items(&held[LIST_WEIGHTS], 4);
    if (fits) {
        const char *counts = given->buf;
        int64_t *starts = held[LIST_STARTS].buf, row = codes * given->itemsize;
        float period = ((const Period *)held[LIST_PERIOD].buf)->period_ns;
        float *time = held[LIST_TIMES].buf, *weight = held[LIST_WEIGHTS].buf;
        const float *delays = held[LIST_PIXEL_DELAYS].buf;
        starts[0] = 0;
        Py_BEGIN_ALLOW_THREADS
        for (int64_t p = 0; p < pixels; p++) {
            int written = starts[p] + codes <= room;
            starts[p + 1] = starts[p]
                          + list_pixel(type, counts + p * row, codes, held[LIST_CODE_TIMES].buf,
                                       delays[p], period, written ? time + starts[p] : NULL,
                                       written ? weight + starts[p] : NULL);
        }
        Py_END_ALLOW_THREADS
    }
    return finish(held, LIST_BUFFERS, fits);
}

/* A call of a loop over photons, which come first among the buffers. */
typedef struct {
    Py_buffer held[SCORES_BUFFERS];
    Photons seen;
} Call;

_Static_assert((int)LAGS_STARTS == (int)WINDOWS_STARTS && (int)LAGS_STARTS == (int)SCORES_STARTS
               && (int)LAGS_STARTS == (int)SQUARES_STARTS
               && (int)LAGS_WEIGHTS == (int)SQUARES_WEIGHTS
               && (int)LAGS_WEIGHTS == (int)WINDOWS_WEIGHTS
               && (int)LAGS_WEIGHTS == (int)SCORES_WEIGHTS, "photons come first");
_Static_assert((int)LAGS_BUFFERS <= (int)SCORES_BUFFERS
               && (int)WINDOWS_BUFFERS <= (int)SCORES_BUFFERS
               && (int)SQUARES_BUFFERS <= (int)SCORES_BUFFERS, "there is room for all buffers");

static int64_t floats(const Call *call, int place) { return items(&call->held[place], 4); }

static int each(const Call *call, int place) /* pixel's floats in a buffer */
{
    return call->seen.pixels > 0 ? (int)(floats(call, place) / call->seen.pixels) : 0;
}

static int has_grid(const Call *call, int place) { return call->held[place].len == sizeof(Grid); }

static float cells_per_ns(const Call *call, int place)
{
    return ((const Grid *)call->held[place].buf)->cells_per_ns;
}

/* Run a loop over photons without the interpreter's lock, if its buffers fit one another. */
static PyObject *over_photons(PyObject *args, Py_ssize_t count, Py_ssize_t reads,
                              int (*check)(const Call *), void (*loop)(const Call *))
{
    Call call;
    if (!hold(args, count, reads, call.held))
        return NULL;
    const Py_buffer *held = call.held;
    call.seen = (Photons){items(&held[LAGS_STARTS], 8) - 1, held[LAGS_STARTS].buf,
                          held[LAGS_TIMES].buf, held[LAGS_WEIGHTS].buf};
    int fits = call.seen.pixels >= 0 && floats(&call, LAGS_TIMES) == floats(&call, LAGS_WEIGHTS)
            && call.seen.starts[call.seen.pixels] <= floats(&call, LAGS_TIMES) && check(&call);
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        loop(&call);
        Py_END_ALLOW_THREADS
    }
    return finish(call.held, count, fits);
}

static int lags_fit(const Call *call)
{
    int64_t cells = floats(call, LAGS_TABLE), count = floats(call, LAGS_LAGS);
    const int32_t *lags = call->held[LAGS_LAGS].buf;
    int fits = has_grid(call, LAGS_GRID) && floats(call, LAGS_RESULT) == call->seen.pixels * count;
    for (int l = 0; fits && l < count; l++)
        fits = lags[l] > -cells && lags[l] < cells;
    return fits;
}

static void run_lags(const Call *call)
{
    const Py_buffer *held = call->held;
    lag_likelihood(&call->seen, held[LAGS_TABLE].buf, (int)floats(call, LAGS_TABLE),
                   cells_per_ns(call, LAGS_GRID), held[LAGS_LAGS].buf,
                   (int)floats(call, LAGS_LAGS), held[LAGS_RESULT].buf);
}

static PyObject *py_lags(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, LAGS_BUFFERS, LAGS_READS, lags_fit, run_lags);
}

static int windows_fit(const Call *call)
{
    int64_t cells = items(&call->held[WINDOWS_OWNERS], 1);
    const int8_t *owners = call->held[WINDOWS_OWNERS].buf;
    int fits = floats(call, WINDOWS_DELAYS) == call->seen.pixels && has_grid(call, WINDOWS_GRID);
    for (int64_t cell = 0; fits && cell < cells; cell++)
        fits = owners[cell] >= 0 && owners[cell] < each(call, WINDOWS_RESULT);
    return fits;
}

static void run_windows(const Call *call)
{
    const Py_buffer *held = call->held;
    windows(&call->seen, held[WINDOWS_DELAYS].buf, held[WINDOWS_OWNERS].buf,
            (int)items(&held[WINDOWS_OWNERS], 1), cells_per_ns(call, WINDOWS_GRID),
            each(call, WINDOWS_RESULT), held[WINDOWS_RESULT].buf);
}

static PyObject *py_windows(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, WINDOWS_BUFFERS, WINDOWS_READS, windows_fit, run_windows);
}

static int64_t squares_of(const Call *call) { return items(&call->held[SQUARES_PIXELS], 8); }

static int squares_fit(const Call *call)
{
    const Py_buffer *held = call->held;
    int64_t cells = items(&held[SQUARES_OWNERS], 1), count = squares_of(call);
    const int8_t *owners = held[SQUARES_OWNERS].buf;
    const int64_t *pixels = held[SQUARES_PIXELS].buf;
    const int32_t *reach = held[SQUARES_REACH].buf;
    const SquaresSize *size = held[SQUARES_SIZE].buf;
    int64_t each = count > 0 ? floats(call, SQUARES_RESULT) / count : 0;
    int fits = held[SQUARES_SIZE].len == sizeof *size && size->rows > 0 && size->cols > 0
            && (int64_t)size->rows * size->cols == call->seen.pixels && has_grid(call, SQUARES_GRID)
            && floats(call, SQUARES_REACH) == count && floats(call, SQUARES_DELAYS) == count
            && floats(call, SQUARES_RESULT) == each * count;
    for (int64_t s = 0; fits && s < count; s++)
        fits = pixels[s] >= 0 && pixels[s] < call->seen.pixels && reach[s] >= 0
            && reach[s] <= size->rows + size->cols;
    for (int64_t cell = 0; fits && count > 0 && cell < cells; cell++)
        fits = owners[cell] >= 0 && owners[cell] < each;
    return fits;
}

static void run_squares(const Call *call)
{
    const Py_buffer *held = call->held;
    const SquaresSize *size = held[SQUARES_SIZE].buf;
    int64_t count = squares_of(call);
    if (count > 0)
        squares(&call->seen, size->rows, size->cols, held[SQUARES_PIXELS].buf,
                held[SQUARES_REACH].buf, count, held[SQUARES_DELAYS].buf, held[SQUARES_OWNERS].buf,
                (int)items(&held[SQUARES_OWNERS], 1), cells_per_ns(call, SQUARES_GRID),
                (int)(floats(call, SQUARES_RESULT) / count), held[SQUARES_RESULT].buf);
}

static PyObject *py_squares(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, SQUARES_BUFFERS, SQUARES_READS, squares_fit, run_squares);
}

static int scores_fit(const Call *call)
{
    int64_t pixels = call->seen.pixels;
    return each(call, SCORES_AMPLITUDES) > 0 && floats(call, SCORES_DELAYS) == pixels
        && floats(call, SCORES_SHARES) == floats(call, SCORES_SLOPES)
        && floats(call, SCORES_FLOORS) == pixels && has_grid(call, SCORES_GRID)
        && floats(call, SCORES_SCORE) == pixels && floats(call, SCORES_INFORMATION) == pixels;
}

static void run_scores(const Call *call)
{
    const Py_buffer *held = call->held;
    int bands = each(call, SCORES_AMPLITUDES);
    scores(&call->seen, held[SCORES_DELAYS].buf, held[SCORES_SHARES].buf, held[SCORES_SLOPES].buf,
           (int)(floats(call, SCORES_SHARES) / bands), cells_per_ns(call, SCORES_GRID), bands,
           held[SCORES_AMPLITUDES].buf, held[SCORES_FLOORS].buf, held[SCORES_SCORE].buf,
           held[SCORES_INFORMATION].buf);
}

static PyObject *py_scores(PyObject *self, PyObject *args)
{
    (void)self;
    return over_photons(args, SCORES_BUFFERS, SCORES_READS, scores_fit, run_scores);
}

static PyObject *py_pool(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[POOL_BUFFERS];
    if (!hold(args, POOL_BUFFERS, POOL_READS, held))
        return NULL;
    const PoolSizes *n = held[POOL_SIZES].buf;
    const PoolLimits *limits = held[POOL_LIMITS].buf;
    const int32_t *steps = held[POOL_STEPS].buf;
    int fits = held[POOL_SIZES].len == sizeof *n && held[POOL_LIMITS].len == sizeof *limits;
    Pool pool = {0};
    int count = (int)items(&held[POOL_KERNEL], 4);
    if (fits) {
        int64_t size = (int64_t)n->rows * n->cols;
        int64_t stride = n->cols + 2 * n->rim + LANES;
        pool = (Pool){
            .rows = n->rows, .cols = n->cols, .rim = n->rim, .groups = n->groups,
            .planes = n->planes, .spectral = n->spectral, .stride = stride,
            .plane = stride * (n->rows + 2 * n->rim), .roots = held[POOL_ROOTS].buf,
            .delays = held[POOL_DELAYS].buf, .valid = held[POOL_VALID].buf,
            .data = held[POOL_DATA].buf, .trust = held[POOL_TRUST].buf,
            .information = held[POOL_INFORMATION].buf, .active = held[POOL_ACTIVE].buf,
            .color_limit = limits->color, .depth_color_limit = limits->depth_color,
            .depth_limit = limits->depth,
        };
        fits = n->first_row >= 0 && n->first_row <= n->end_row && n->end_row <= n->rows
            && n->cols > 0 && n->rim >= 0 && n->groups >= 1 && n->groups <= MOST_GROUPS
            && n->planes >= 1 && n->planes <= MOST_PLANES && n->spectral >= 0
            && n->spectral <= n->planes && items(&held[POOL_STEPS], 4) == 2 * (int64_t)count
            && items(&held[POOL_ROOTS], 4) == pool.plane * n->groups
            && items(&held[POOL_DELAYS], 4) == pool.plane
            && items(&held[POOL_VALID], 4) == pool.plane
            && items(&held[POOL_DATA], 4) == pool.plane * n->planes
            && items(&held[POOL_TRUST], 4) == size && items(&held[POOL_INFORMATION], 4) == size
            && items(&held[POOL_ACTIVE], 1) == size
            && items(&held[POOL_RESULT], 4) == size * (n->planes + 3);
    }
    for (int i = 0; fits && i < 2 * count; i++)
        fits = steps[i] >= -pool.rim && steps[i] <= pool.rim;
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        pool_rows(&pool, n->first_row, n->end_row, steps, held[POOL_KERNEL].buf, count,
                  held[POOL_RESULT].buf);
        Py_END_ALLOW_THREADS
    }
    return finish(held, POOL_BUFFERS, fits);
}

static PyMethodDef methods[] = {
    {"list", py_list, METH_VARARGS, "Photons of pixels."},
    {"lags", py_lags, METH_VARARGS, "Log-likelihood of lags."},
    {"windows", py_windows, METH_VARARGS, "Photons in the window of each band at a delay."},
    {"squares", py_squares, METH_VARARGS, "Photons in the window of each band, over squares."},
    {"scores", py_scores, METH_VARARGS, "Score and information of the delay."},
    {"pool", py_pool, METH_VARARGS, "Weighted sums over neighbors."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernels", "Loops of the pooled method, in C.", -1, methods,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddStringConstant(made, "ABI", ABI)) {
        Py_DECREF(made);
        return NULL;
    }
    return made;
}
