/* SPDX-License-Identifier: Apache-2.0 */
/* Compare the counts of cells of the image with what earlier counts predict, by several contrasts;
 * numpy_scene_change.py holds the definition. */
#include <math.h>

typedef struct {
    const double *newest, *earlier; /* (tile row, tile col, group) */
    const double *ratio; /* (tile row, tile col): exposures of newest per earlier one, or 0 */
    size_t rows, cols, groups;
    size_t size, window; /* tiles on a side of a cell; groups in a time window */
    double brightness_tolerance, shift_tolerance; /* relative; in groups */
    double *room; /* of 4 rows of groups + SMOOTHINGS */
    double *out; /* (cell row, cell col): standard deviations of the most significant contrast */
} Comparison;

/* Counts of a cell, what is expected, and the variance of that, by groups. */
typedef struct { double *seen, *expected, *spread, ratio; } Cell;

INLINE double n_log(double counts, double mean)
{
    return counts > 0 && mean > 0 ? counts * log(counts / mean) : 0;
}

/* Root of the deviance of two Poisson counts with a known ratio of exposures, if it exceeds `most`,
 * which is returned otherwise. Half of a deviance is at most Pearson's chi-square, which is tried
 * first as it takes no logarithms. */
INLINE double count_significance(const Comparison *c, double seen, double expected, double spread,
                                 double ratio, double most)
{
    const double tolerance = c->brightness_tolerance * expected;
    const double times = expected > 0 ? (spread + tolerance * tolerance) / expected : ratio;
    const double counted = expected > 0 ? expected / times : 0;
    const double share = times / (1 + times), total = seen + counted;
    const double mean = total * share, other = total * (1 - share), gap = seen - mean;
    if (2 * gap * gap * total <= most * most * mean * other)
        return most;
    return fmax(most, sqrt(fmax(2 * (n_log(seen, mean) + n_log(counted, other)), 0)));
}

/* Smoothed counts, as many photons as were counted earlier; the ends are repeated beyond them. */
INLINE void smooth(const double *counts, size_t groups, double scale, double *out)
{
    enum { REACH = SMOOTHINGS / 2 };
    for (size_t i = 0; i < groups + SMOOTHINGS; i++) {
        const size_t at = i < REACH ? 0 : i - REACH;
        out[i] = scale * counts[at < groups ? at : groups - 1];
    }
    for (size_t left = SMOOTHINGS; left--;)
        for (size_t i = 0; i < groups + left; i++)
            out[i] = 0.5 * (out[i] + out[i + 1]);
}

/* A shift in time changes the counts of each group by their derivative. */
INLINE double shift_significance(const Comparison *c, const Cell *cell)
{
    const size_t groups = c->groups;
    const double *seen = cell->seen, *expected = cell->expected, *spread = cell->spread;
    double *smoothed = c->room;
    double total = 0, variance = 0, mean = 0;
    for (size_t i = 0; i < groups; i++) {
        total += expected[i];
        variance += spread[i];
    }
    const double scale = variance > 0 ? total / variance : 1;
    smooth(expected, groups, scale, smoothed);
    for (size_t i = 0; i < groups; i++)
        mean += smoothed[i];
    const double floor = 1 + 0.05 * mean / (double)groups;
    double shift = 0, information = 0, of_prediction = 0;
    for (size_t i = 0; i < groups; i++) {
        const size_t before = i ? i - 1 : 0, after = i + 1 < groups ? i + 1 : i;
        const double slope = (smoothed[after] - smoothed[before]) / (double)(after - before);
        const double weight = slope / (smoothed[i] + floor);
        shift += weight * (seen[i] - expected[i]);
        information += weight * weight * smoothed[i];
        of_prediction += weight * weight * spread[i];
    }
    information /= scale;
    const double tolerance = c->shift_tolerance * information;
    const double all = information + of_prediction + tolerance * tolerance;
    return all > 0 ? fabs(shift) / sqrt(all) : 0;
}

INLINE double compare(const Comparison *c, const Cell *cell)
{
    double most = shift_significance(c, cell), seen = 0, expected = 0, spread = 0;
    for (size_t first = 0; first < c->groups; first += c->window) {
        double s = 0, e = 0, v = 0;
        for (size_t i = first; i < c->groups && i < first + c->window; i++) {
            s += cell->seen[i];
            e += cell->expected[i];
            v += cell->spread[i];
        }
        most = count_significance(c, s, e, v, cell->ratio, most);
        seen += s;
        expected += e;
        spread += v;
    }
    return count_significance(c, seen, expected, spread, cell->ratio, most);
}

/* Sum of the tiles of a cell that are compared. */
INLINE void sum_tiles(const Comparison *c, size_t row, size_t col, Cell *cell)
{
    const size_t groups = c->groups;
    double ratios = 0, tiles = 0;
    memset(cell->seen, 0, 3 * groups * sizeof *cell->seen);
    for (size_t r = row; r < c->rows && r < row + c->size; r++)
        for (size_t k = col; k < c->cols && k < col + c->size; k++) {
            const size_t tile = r * c->cols + k;
            const double ratio = c->ratio[tile];
            const double *newest = c->newest + tile * groups, *earlier = c->earlier + tile * groups;
            if (!(ratio > 0))
                continue;
            ratios += ratio;
            tiles++;
            for (size_t i = 0; i < groups; i++) {
                const double expected = earlier[i] * ratio;
                cell->seen[i] += newest[i];
                cell->expected[i] += expected;
                cell->spread[i] += expected * ratio;
            }
        }
    cell->ratio = tiles > 0 ? ratios / tiles : 0;
}

INLINE void compare_any(const Comparison *c)
{
    double *rows = c->room + c->groups + SMOOTHINGS, *out = c->out;
    Cell cell = {.seen = rows, .expected = rows + c->groups, .spread = rows + 2 * c->groups};
    for (size_t row = 0; row < c->rows; row += c->size)
        for (size_t col = 0; col < c->cols; col += c->size) {
            sum_tiles(c, row, col, &cell);
            *out++ = compare(c, &cell);
        }
}

static void compare_plain(const Comparison *c) { compare_any(c); }
#ifdef X86_DISPATCH
__attribute__((target("avx2"))) static void compare_with_avx2(const Comparison *c)
{
    compare_any(c);
}
#endif

static void compare_cells(const Comparison *c)
{
#ifdef X86_DISPATCH
    if (has_avx2) {
        compare_with_avx2(c);
        return;
    }
#endif
    compare_plain(c);
}
