/* SPDX-License-Identifier: Apache-2.0 */
/* Made by tools/generate_kernel_headers.py from hueflight/backend/sums.py:
 * change that file and run the tool. */
#ifndef HUEFLIGHT_SUMS_ABI_H
#define HUEFLIGHT_SUMS_ABI_H
#include <stdint.h>

#define ABI "82207a2a48e3681b" /* hash of what follows */

enum { MOST_SUMS = 32 }; /* per pixel that there is room for */
enum { MOST_BANDS = 30 }; /* that there is room for */
enum { MOST_LAGS = 128 }; /* of the search that there is room for */
enum { LANES = 16 }; /* pixels side by side, and floats to which rows are made up */

/* Sizes and scales of the tables, and constants of the estimator. */
typedef struct {
    int32_t bands;
    int32_t sums;
    int32_t lags; /* delays that the search looks at */
    int32_t lag_phases; /* tabulated delays per lag */
    int32_t rest; /* null directions of a lag */
    float first_ns; /* first tabulated delay */
    float phase_ns; /* between tabulated delays */
    float floor_share; /* least background in the weights, of all photons */
    float floor_photons; /* and in photons */
    float ridge; /* on the diagonal, relative to it */
} Sizes;
_Static_assert(sizeof(Sizes) == 40, "Sizes is laid out as NumPy lays it out");

/* estimate: delay, amplitudes and background of pixels from their sums; (...) rows are made up to LANES */
enum {
    ESTIMATE_SIZES = 0, /* Sizes */
    ESTIMATE_SUMS = 1, /* float32: (pixel, sum); the first is the number of photons */
    ESTIMATE_NUMBER = 2, /* int32: (pixel,) place of its offset in the tables */
    ESTIMATE_WHITEN = 3, /* float32: (sum, sum) matrix to whitened sums */
    ESTIMATE_DARK_TEST = 4, /* float32: (sum - 1, sum) matrix on whitened sums less background */
    ESTIMATE_SEPARATE = 5, /* float32: (offset, phase, sum, (sum)) matrix to photons and rest */
    ESTIMATE_SLOPES = 6, /* float32: (offset, phase, band, (sum)) of photons and rest, per ns */
    ESTIMATE_DARK = 7, /* float32: (offset, (sum)) */
    ESTIMATE_COVARIANCES = 8, /* float32: (phase, band + 1, (entry)) of photons and rest */
    ESTIMATE_NULLS = 9, /* float32: (lag, rest, sum) */
    ESTIMATE_DELAY = 10, /* float64: (pixel,) ns */
    ESTIMATE_DELAY_STD = 11, /* float64: (pixel,) its deviation, ns */
    ESTIMATE_AMPLITUDES = 12, /* float64: (pixel, band) photons */
    ESTIMATE_AMPLITUDE_STD = 13, /* float64: (pixel, band) their deviations */
    ESTIMATE_BACKGROUND = 14, /* float64: (pixel,) photons */
    ESTIMATE_DISTANCE = 15, /* float64: (pixel,) squared, from the fit */
    ESTIMATE_DARK_DISTANCE = 16, /* float64: (pixel,) squared, from background */
    ESTIMATE_READS = 10,
    ESTIMATE_BUFFERS = 17
};

#endif
