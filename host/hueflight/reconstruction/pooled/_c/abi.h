/* SPDX-License-Identifier: Apache-2.0 */
/* Made by tools/generate_kernel_headers.py from hueflight/backend/pooled.py:
 * change that file and run the tool. */
#ifndef HUEFLIGHT_POOLED_ABI_H
#define HUEFLIGHT_POOLED_ABI_H
#include <stdint.h>

#define ABI "03edb5e658bb1da2" /* hash of what follows */

enum { MOST_PLANES = 40 }; /* planes of data that have room in the registers */
enum { MOST_GROUPS = 8 }; /* groups of bands by which neighbors are compared */
enum { LANES = 16 }; /* pixels side by side */

/* Scale of tables over the period. */
typedef struct {
    float cells_per_ns;
} Grid;
_Static_assert(sizeof(Grid) == 4, "Grid is laid out as NumPy lays it out");

/* Time after which pulses repeat. */
typedef struct {
    float period_ns;
} Period;
_Static_assert(sizeof(Period) == 4, "Period is laid out as NumPy lays it out");

/* Shape of the image that squares lie in. */
typedef struct {
    int32_t rows;
    int32_t cols;
} SquaresSize;
_Static_assert(sizeof(SquaresSize) == 8, "SquaresSize is laid out as NumPy lays it out");

/* What a call of pool works on. */
typedef struct {
    int32_t first_row;
    int32_t end_row; /* one past the last */
    int32_t rows;
    int32_t cols;
    int32_t rim; /* padding around the image, pixels */
    int32_t groups; /* of bands by which neighbors are compared */
    int32_t planes; /* that are summed */
    int32_t spectral; /* planes that are summed with the weights of spectra */
} PoolSizes;
_Static_assert(sizeof(PoolSizes) == 32, "PoolSizes is laid out as NumPy lays it out");

/* Inverse of the log-likelihood ratios at which a neighbor counts no longer. */
typedef struct {
    float color; /* of the spectrum */
    float depth_color; /* of the spectrum, for the weights of depth */
    float depth; /* of the depth */
} PoolLimits;
_Static_assert(sizeof(PoolLimits) == 12, "PoolLimits is laid out as NumPy lays it out");

/* list: photons of histograms; starts tells how many there are even if they do not fit */
enum {
    LIST_COUNTS = 0, /* any: (pixel, code) uint16, uint32 or float32 */
    LIST_CODE_TIMES = 1, /* float32: (code,) below 0 for codes that are no photon */
    LIST_PIXEL_DELAYS = 2, /* float32: (pixel,) */
    LIST_PERIOD = 3, /* Period */
    LIST_STARTS = 4, /* int64: (pixel + 1,) first entry of each pixel */
    LIST_TIMES = 5, /* float32: (entry,) within the period, ns */
    LIST_WEIGHTS = 6, /* float32: (entry,) photons that share the time */
    LIST_READS = 4,
    LIST_BUFFERS = 7
};

/* lags: log-likelihood of delays */
enum {
    LAGS_STARTS = 0, /* int64: (pixel + 1,) first entry of each pixel */
    LAGS_TIMES = 1, /* float32: (entry,) within the period, ns */
    LAGS_WEIGHTS = 2, /* float32: (entry,) photons that share the time */
    LAGS_TABLE = 3, /* float32: (cell,) log-likelihood of a photon */
    LAGS_GRID = 4, /* Grid */
    LAGS_LAGS = 5, /* int32: (lag,) in cells */
    LAGS_RESULT = 6, /* float32: (pixel, lag) */
    LAGS_READS = 6,
    LAGS_BUFFERS = 7
};

/* windows: photons in the window of each band at a delay */
enum {
    WINDOWS_STARTS = 0, /* int64: (pixel + 1,) first entry of each pixel */
    WINDOWS_TIMES = 1, /* float32: (entry,) within the period, ns */
    WINDOWS_WEIGHTS = 2, /* float32: (entry,) photons that share the time */
    WINDOWS_DELAYS = 3, /* float32: (pixel,) */
    WINDOWS_OWNERS = 4, /* int8: (cell,) window that a cell belongs to */
    WINDOWS_GRID = 5, /* Grid */
    WINDOWS_RESULT = 6, /* float32: (window, pixel) */
    WINDOWS_READS = 6,
    WINDOWS_BUFFERS = 7
};

/* squares: photons in the window of each band at a delay, over squares of pixels */
enum {
    SQUARES_STARTS = 0, /* int64: (pixel + 1,) first entry of each pixel */
    SQUARES_TIMES = 1, /* float32: (entry,) within the period, ns */
    SQUARES_WEIGHTS = 2, /* float32: (entry,) photons that share the time */
    SQUARES_SIZE = 3, /* SquaresSize */
    SQUARES_PIXELS = 4, /* int64: (square,) middle of each square */
    SQUARES_REACH = 5, /* int32: (square,) pixels to either side */
    SQUARES_DELAYS = 6, /* float32: (square,) */
    SQUARES_OWNERS = 7, /* int8: (cell,) window that a cell belongs to */
    SQUARES_GRID = 8, /* Grid */
    SQUARES_RESULT = 9, /* float32: (square, window) */
    SQUARES_READS = 9,
    SQUARES_BUFFERS = 10
};

/* scores: score and information of delays */
enum {
    SCORES_STARTS = 0, /* int64: (pixel + 1,) first entry of each pixel */
    SCORES_TIMES = 1, /* float32: (entry,) within the period, ns */
    SCORES_WEIGHTS = 2, /* float32: (entry,) photons that share the time */
    SCORES_DELAYS = 3, /* float32: (pixel,) */
    SCORES_SHARES = 4, /* float32: (cell, band) per ns */
    SCORES_SLOPES = 5, /* float32: (cell, band) derivative of shares by time */
    SCORES_AMPLITUDES = 6, /* float32: (pixel, band) photons */
    SCORES_FLOORS = 7, /* float32: (pixel,) background per ns */
    SCORES_GRID = 8, /* Grid */
    SCORES_SCORE = 9, /* float32: (pixel,) */
    SCORES_INFORMATION = 10, /* float32: (pixel,) per ns^2 */
    SCORES_READS = 9,
    SCORES_BUFFERS = 11
};

/* pool: weighted sums over neighbors */
enum {
    POOL_SIZES = 0, /* PoolSizes */
    POOL_LIMITS = 1, /* PoolLimits */
    POOL_STEPS = 2, /* int32: (neighbor, 2) rows and columns from the pixel */
    POOL_KERNEL = 3, /* float32: (neighbor,) weight by distance */
    POOL_ROOTS = 4, /* float32: (group, row, col) padded: square roots of pooled counts */
    POOL_DELAYS = 5, /* float32: (row, col) padded */
    POOL_VALID = 6, /* float32: (row, col) padded: 1 or 0 */
    POOL_DATA = 7, /* float32: (plane, row, col) padded */
    POOL_TRUST = 8, /* float32: (row, col) twice the pixels pooled so far */
    POOL_INFORMATION = 9, /* float32: (row, col) half the information on the delay so far */
    POOL_ACTIVE = 10, /* uint8: (row, col) pixels that are asked for */
    POOL_RESULT = 11, /* float32: (plane + 3, row, col): sums, weights, squares, depth squares */
    POOL_READS = 11,
    POOL_BUFFERS = 12
};

#endif
