/* SPDX-License-Identifier: Apache-2.0 */
/* Estimates from sums, LANES pixels side by side; hueflight/reconstruction/sums/estimator.py defines
 * the same in NumPy. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdlib.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define EVERY_WIDTH __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_WIDTH
#endif

#include "abi.h"
#include "vector.h" /* after LANES */

#define LEAST_INFORMATION 1e-20f /* about the delay, where there is none */
enum { MOST_ENTRIES = MOST_SUMS * (MOST_SUMS + 1) / 2 };

typedef struct {
    Sizes s;
    int row, entries; /* floats of a row of sums, and of a packed covariance */
    const float *whiten, *dark_test; /* matrices */
    const float *separate, *slopes, *dark, *covariances, *nulls;
} Tables;

enum { TOGETHER = 4 }; /* sums of products that do not wait for one another */

/* What a block of pixels needs; vectors hold one value of each pixel. */
typedef struct {
    vec sums[MOST_SUMS];
    vec separated[MOST_SUMS]; /* photons of bands, background, and the rest */
    vec slope[MOST_SUMS], weights[MOST_SUMS];
    vec covariance[MOST_ENTRIES + LANES];
    vec deviations[MOST_SUMS];
    vec photons, delay, grid, delay_std, distance, dark_distance;
    float rows[LANES][LANES]; /* of the pixels, to be transposed */
    int32_t phase[LANES], number[LANES];
} Block;

INLINE int made_up(int count) { return (count + LANES - 1) / LANES * LANES; }

/* LANES floats of each pixel become as many vectors. */
INLINE void transposed(float (*rows)[LANES], vec *to)
{
    vec x[LANES];
    for (int i = 0; i < LANES; i++)
        x[i] = load(rows[i]);
#pragma GCC unroll 4
    for (int distance = 1; distance < LANES; distance *= 2) {
        ivec odd = (lane_numbers() & distance) != 0;
        for (int i = 0; i < LANES; i++) {
            if (i & distance)
                continue;
            vec a = x[i], b = x[i + distance];
            x[i] = choose(odd, swap(b, distance), a);
            x[i + distance] = choose(odd, b, swap(a, distance));
        }
    }
    for (int i = 0; i < LANES; i++)
        to[i] = x[i];
}

/* Products of some rows of a matrix, `step` floats apart, with sums. */
INLINE void some_products(const float *rows, int step, const vec *sums, int width, vec *to)
{
    vec x[TOGETHER] = {{0}};
    for (int k = 0; k < width; k++)
        for (int i = 0; i < TOGETHER; i++)
            x[i] += rows[i * step + k] * sums[k];
    for (int i = 0; i < TOGETHER; i++)
        to[i] = x[i];
}

/* Products of all rows of a matrix. */
INLINE void product(const float *matrix, int rows, const vec *sums, int width, vec *to)
{
    if (rows < TOGETHER)
        for (int i = 0; i < rows; i++) {
            vec same[TOGETHER];
            some_products(matrix + i * width, 0, sums, width, same);
            to[i] = same[0];
        }
    else
        for (int i = 0; i < rows; i += TOGETHER) {
            int from = i + TOGETHER <= rows ? i : rows - TOGETHER;
            some_products(matrix + from * width, width, sums, width, to + from);
        }
}

/* Sums times the whitening matrix, and their squared distance from those of background alone. */
INLINE void whiten(const Tables *t, Block *b)
{
    int sums = t->s.sums;
    vec white[MOST_SUMS], rest[MOST_SUMS], total = {0};
    b->photons = b->sums[0];
    product(t->whiten, sums, b->sums, sums, white);
    for (int part = 0; part < t->row; part += LANES) {
        for (int lane = 0; lane < LANES; lane++)
            store(b->rows[lane], load(t->dark + (size_t)b->number[lane] * (size_t)t->row + part));
        transposed(b->rows, rest + part);
    }
    for (int k = 0; k < sums; k++) {
        b->sums[k] = white[k];
        rest[k] = white[k] - b->photons * rest[k];
    }
    product(t->dark_test, sums - 1, rest, sums, white);
    for (int i = 0; i < sums - 1; i++)
        total += white[i] * white[i];
    b->dark_distance = total / b->photons;
}

/* Delay by the lag at which the sums are nearest to those of any light. */
INLINE void search(const Tables *t, Block *b)
{
    int lags = t->s.lags, sums = t->s.sums, step = t->s.rest * sums;
    vec distances[MOST_LAGS], least = fill(INFINITY), best = {0};
    for (int i = 0; i < lags; i += TOGETHER) {
        int lag = i + TOGETHER <= lags ? i : lags - TOGETHER;
        vec along[TOGETHER], total[TOGETHER] = {{0}};
        for (int r = 0; r < t->s.rest; r++) {
            some_products(t->nulls + lag * step + r * sums, step, b->sums, sums, along);
            for (int j = 0; j < TOGETHER; j++)
                total[j] += along[j] * along[j];
        }
        for (int j = 0; j < TOGETHER; j++)
            distances[lag + j] = total[j];
    }
    for (int lag = 0; lag < lags; lag++) {
        best = choose(distances[lag] < least, fill((float)lag), best);
        least = lesser(distances[lag], least);
    }
    const float *all = (const float *)distances;
    float lag_ns = t->s.phase_ns * (float)t->s.lag_phases;
    float number[LANES], delay[LANES];
    store(number, best);
    for (int lane = 0; lane < LANES; lane++) {
        int here = (int)number[lane], inner = here < 1 ? 1 : here > lags - 2 ? lags - 2 : here;
        const float *at = all + inner * LANES + lane;
        float left = at[-LANES], right = at[LANES], bend = left - 2 * at[0] + right;
        float shift = bend > 0 ? 0.5f * (left - right) / bend : 0;
        shift = shift < -0.5f ? -0.5f : shift > 0.5f ? 0.5f : shift;
        if (here != inner)
            shift = (float)(here - inner);
        delay[lane] = t->s.first_ns + ((float)inner + shift) * lag_ns;
    }
    b->delay = load(delay);
}

INLINE int phases_of(const Tables *t) { return (t->s.lags - 1) * t->s.lag_phases + 1; }

/* Nearest tabulated delay of each pixel. */
INLINE void nearest_phase(const Tables *t, Block *b)
{
    int phases = phases_of(t);
    float at[LANES];
    store(at, (b->delay - t->s.first_ns) * (1 / t->s.phase_ns));
    for (int lane = 0; lane < LANES; lane++) {
        int phase = (int)rintf(at[lane]);
        b->phase[lane] = phase < 0 ? 0 : phase >= phases ? phases - 1 : phase;
        at[lane] = (float)b->phase[lane];
    }
    b->grid = load(at) * t->s.phase_ns + t->s.first_ns;
}

/* For each pixel the sum of `count` rows of its own table, `width` floats each, times values of its
 * own. */
INLINE void weighted_rows(Block *b, const float *const *tables, const vec *values, int count,
                          int width, vec *to)
{
    for (int part = 0; part < width; part += LANES) {
        for (int lane = 0; lane < LANES; lane += TOGETHER) {
            vec x[TOGETHER] = {{0}};
            for (int k = 0; k < count; k++)
                for (int i = 0; i < TOGETHER; i++)
                    x[i] += ((const float *)&values[k])[lane + i]
                          * load(tables[lane + i] + k * width + part);
            for (int i = 0; i < TOGETHER; i++)
                store(b->rows[lane + i], x[i]);
        }
        transposed(b->rows, to + part);
    }
}

/* Photons and rest at the nearest tabulated delay; their derivative and covariance for that light. */
INLINE void expect(const Tables *t, Block *b)
{
    int bands = t->s.bands, row = t->row;
    size_t phases = (size_t)phases_of(t);
    const float *separate[LANES], *slopes[LANES], *covariances[LANES];
    for (int lane = 0; lane < LANES; lane++) {
        size_t entry = (size_t)b->number[lane] * phases + (size_t)b->phase[lane];
        separate[lane] = t->separate + entry * (size_t)(t->s.sums * row);
        slopes[lane] = t->slopes + entry * (size_t)(bands * row);
        covariances[lane] = t->covariances + (size_t)b->phase[lane] * (size_t)((bands + 1) * t->entries);
    }
    weighted_rows(b, separate, b->sums, t->s.sums, row, b->separated);
    for (int k = 0; k <= bands; k++)
        b->weights[k] = greater(b->separated[k], fill(0));
    vec floor = b->photons * t->s.floor_share + t->s.floor_photons;
    b->weights[bands] = greater(b->weights[bands], floor);
    weighted_rows(b, slopes, b->weights, bands, row, b->slope);
    weighted_rows(b, covariances, b->weights, bands + 1, t->entries, b->covariance);
}

/* Root of the covariance of the rest, rows of its lower triangle one after the other, in place. */
INLINE void cholesky(vec *a, vec *inverse_root, int size, float ridge)
{
    for (int i = 0; i < size; i++) {
        vec *row = a + i * (i + 1) / 2;
        vec left = row[i] * (1 + ridge);
        for (int j = 0; j < i; j++) {
            const vec *other = a + j * (j + 1) / 2;
            vec x = row[j];
            for (int m = 0; m < j; m++)
                x -= row[m] * other[m];
            row[j] = x * inverse_root[j];
            left -= row[j] * row[j];
        }
        inverse_root[i] = 1.0f / root(greater(left, fill(1e-30f)));
    }
}

/* A vector divided by the root of the covariance of the rest. */
INLINE void divide(const vec *root, const vec *inverse_root, const vec *from, int step, int size,
                   vec *to)
{
    for (int i = 0; i < size; i++) {
        const vec *row = root + i * (i + 1) / 2;
        vec x = from[i * step];
        for (int m = 0; m < i; m++)
            x -= row[m] * to[m];
        to[i] = x * inverse_root[i];
    }
}

/* Delay from the rest, which no light changes; then the light, freed of what it has in common with the
 * noise of the rest. */
INLINE void solve(const Tables *t, Block *b)
{
    int light = t->s.bands + 1, rest = t->s.rest;
    const vec *variance = b->covariance, *common = variance + light;
    vec *own = b->covariance + light + rest * light, inverse_root[MOST_SUMS];
    vec seen[MOST_SUMS], slope[MOST_SUMS], along = {0}, information = {0}, total = {0};
    cholesky(own, inverse_root, rest, t->s.ridge);
    divide(own, inverse_root, b->separated + light, 1, rest, seen);
    divide(own, inverse_root, b->slope + light, 1, rest, slope);
    for (int r = 0; r < rest; r++) {
        along += slope[r] * seen[r];
        information += slope[r] * slope[r];
        total += seen[r] * seen[r];
    }
    vec certainty = 1.0f / greater(information, fill(LEAST_INFORMATION));
    vec moved = along * certainty;
    b->delay_std = root(certainty);
    b->distance = greater(total - along * moved, fill(0));
    for (int r = 0; r < rest; r++)
        seen[r] -= slope[r] * moved;
    for (int k = 0; k < light; k++) {
        vec shared[MOST_SUMS], taken = {0}, left = variance[k], change = b->slope[k];
        divide(own, inverse_root, common + k, light, rest, shared);
        for (int r = 0; r < rest; r++) {
            taken += shared[r] * seen[r];
            left -= shared[r] * shared[r];
            change -= shared[r] * slope[r];
        }
        b->separated[k] -= b->slope[k] * moved + taken;
        b->deviations[k] = root(greater(left, fill(0)) + change * change * certainty);
    }
    vec last = fill(t->s.first_ns + (float)(phases_of(t) - 1) * t->s.phase_ns);
    b->delay = lesser(greater(b->grid + moved, fill(t->s.first_ns)), last);
}

/* Where the results of pixels go. */
typedef struct {
    double *delay, *delay_std, *amplitudes, *amplitude_std, *background, *distance, *dark_distance;
} Results;

INLINE void put(vec values, double *to, int count)
{
    for (int lane = 0; lane < count; lane++)
        to[lane] = ((const float *)&values)[lane];
}

/* One row of each pixel. */
INLINE void put_rows(Block *b, vec *columns, int width, double *to, int count)
{
    for (int part = 0; part < width; part += LANES) {
        int some = width - part < LANES ? width - part : LANES;
        for (int k = 0; k < LANES; k++)
            store(b->rows[k], columns[part + k]);
        vec rows[LANES];
        transposed(b->rows, rows);
        for (int lane = 0; lane < count; lane++)
            for (int k = 0; k < some; k++)
                to[(size_t)lane * (size_t)width + (size_t)(part + k)] = ((const float *)&rows[lane])[k];
    }
}

EVERY_WIDTH
static void estimate(const Tables *t, const float *sums, const int32_t *number, int64_t pixels,
                     Block *b, Results to)
{
    int bands = t->s.bands, width = t->s.sums;
    memset(b, 0, sizeof(Block));
    for (int64_t first = 0; first < pixels; first += LANES) {
        int count = pixels - first < LANES ? (int)(pixels - first) : LANES;
        for (int part = 0; part < t->row; part += LANES) {
            int some = width - part < LANES ? width - part : LANES;
            for (int lane = 0; lane < LANES; lane++) { /* the last pixel fills up */
                int64_t pixel = first + (lane < count ? lane : count - 1);
                b->number[lane] = number[pixel];
                for (int k = 0; k < some; k++)
                    b->rows[lane][k] = sums[pixel * width + part + k];
            }
            transposed(b->rows, b->sums + part);
        }
        whiten(t, b);
        search(t, b);
        nearest_phase(t, b);
        expect(t, b);
        solve(t, b);
        put(b->delay, to.delay + first, count);
        put(b->delay_std, to.delay_std + first, count);
        put(b->distance, to.distance + first, count);
        put(b->dark_distance, to.dark_distance + first, count);
        put(b->separated[bands], to.background + first, count);
        put_rows(b, b->separated, bands, to.amplitudes + first * bands, count);
        put_rows(b, b->deviations, bands, to.amplitude_std + first * bands, count);
    }
}

/* -- Python --------------------------------------------------------------------------------- */

static int64_t floats(const Py_buffer *held) { return held->len / 4; }

static int sizes_fit(const Sizes *s)
{
    return s->bands >= 1 && s->bands <= MOST_BANDS && s->sums >= s->bands + 2
        && s->sums <= MOST_SUMS && s->lags >= TOGETHER && s->lags <= MOST_LAGS && s->lag_phases >= 1
        && s->rest == s->sums - s->bands - 1;
}

static int buffers_fit(const Py_buffer *held, const Tables *t)
{
    int64_t bands = t->s.bands, sums = t->s.sums, lags = t->s.lags, phases = phases_of(t);
    int64_t offsets = floats(&held[ESTIMATE_DARK]) / t->row;
    int64_t pixels = floats(&held[ESTIMATE_NUMBER]), doubles = 2 * pixels;
    int fits = floats(&held[ESTIMATE_SUMS]) == pixels * sums
            && floats(&held[ESTIMATE_WHITEN]) == sums * sums
            && floats(&held[ESTIMATE_DARK_TEST]) == (sums - 1) * sums
            && floats(&held[ESTIMATE_SEPARATE]) == offsets * phases * sums * t->row
            && floats(&held[ESTIMATE_SLOPES]) == offsets * phases * bands * t->row
            && floats(&held[ESTIMATE_COVARIANCES]) == phases * (bands + 1) * t->entries
            && floats(&held[ESTIMATE_NULLS]) == lags * t->s.rest * sums
            && floats(&held[ESTIMATE_AMPLITUDES]) == doubles * bands
            && floats(&held[ESTIMATE_AMPLITUDE_STD]) == doubles * bands;
    const int lines[] = {ESTIMATE_DELAY, ESTIMATE_DELAY_STD, ESTIMATE_BACKGROUND, ESTIMATE_DISTANCE,
                         ESTIMATE_DARK_DISTANCE};
    for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++)
        fits = fits && floats(&held[lines[i]]) == doubles;
    const int32_t *number = held[ESTIMATE_NUMBER].buf;
    for (int64_t p = 0; fits && p < pixels; p++)
        fits = number[p] >= 0 && number[p] < offsets;
    return fits;
}

/* Run without the interpreter's lock; 0 if there is no memory. */
static int run(const Py_buffer *held, const Tables *t)
{
    Block *block = malloc(sizeof(Block) + 64);
    if (!block)
        return 0;
    Block *aligned = (Block *)(((uintptr_t)block + 63) / 64 * 64);
    Py_BEGIN_ALLOW_THREADS
    estimate(t, held[ESTIMATE_SUMS].buf, held[ESTIMATE_NUMBER].buf,
             floats(&held[ESTIMATE_NUMBER]), aligned,
             (Results){held[ESTIMATE_DELAY].buf, held[ESTIMATE_DELAY_STD].buf,
                       held[ESTIMATE_AMPLITUDES].buf, held[ESTIMATE_AMPLITUDE_STD].buf,
                       held[ESTIMATE_BACKGROUND].buf, held[ESTIMATE_DISTANCE].buf,
                       held[ESTIMATE_DARK_DISTANCE].buf});
    Py_END_ALLOW_THREADS
    free(block);
    return 1;
}

static PyObject *py_estimate(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer held[ESTIMATE_BUFFERS];
    Py_ssize_t count = 0;
    if (PyTuple_Size(args) != ESTIMATE_BUFFERS) {
        PyErr_Format(PyExc_TypeError, "%d buffers are needed", (int)ESTIMATE_BUFFERS);
        return NULL;
    }
    for (; count < ESTIMATE_BUFFERS; count++) {
        int flags = PyBUF_C_CONTIGUOUS | (count >= ESTIMATE_READS ? PyBUF_WRITABLE : 0);
        if (PyObject_GetBuffer(PyTuple_GetItem(args, count), &held[count], flags))
            break;
    }
    int fits = 0, ran = 1;
    if (count == ESTIMATE_BUFFERS && held[ESTIMATE_SIZES].len == sizeof(Sizes)
        && sizes_fit(held[ESTIMATE_SIZES].buf)) {
        Tables t = {.s = *(const Sizes *)held[ESTIMATE_SIZES].buf};
        t.row = made_up(t.s.sums);
        t.entries = made_up(t.s.bands + 1 + t.s.rest * (t.s.bands + 1) + t.s.rest * (t.s.rest + 1) / 2);
        t.whiten = held[ESTIMATE_WHITEN].buf;
        t.dark_test = held[ESTIMATE_DARK_TEST].buf;
        t.separate = held[ESTIMATE_SEPARATE].buf;
        t.slopes = held[ESTIMATE_SLOPES].buf;
        t.dark = held[ESTIMATE_DARK].buf;
        t.covariances = held[ESTIMATE_COVARIANCES].buf;
        t.nulls = held[ESTIMATE_NULLS].buf;
        fits = buffers_fit(held, &t);
        ran = !fits || run(held, &t);
    }
    int complete = count == ESTIMATE_BUFFERS;
    while (count--)
        PyBuffer_Release(&held[count]);
    if (!ran)
        return PyErr_NoMemory();
    if (!fits) {
        if (complete)
            PyErr_SetString(PyExc_ValueError, "buffers do not fit one another");
        return NULL;
    }
    Py_INCREF(Py_None);
    return Py_None;
}

static PyMethodDef functions[] = {{"estimate", py_estimate, METH_VARARGS, NULL},
                                  {NULL, NULL, 0, NULL}};

static int add_hash(PyObject *module) { return PyModule_AddStringConstant(module, "ABI", ABI); }

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)add_hash}, {0, NULL}};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernels",
                                    "Estimates from sums.", 0, functions, slots,
                                    NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModuleDef_Init(&module); }
