/* SPDX-License-Identifier: Apache-2.0 */
/* Made by tools/generate_kernel_headers.py from hueflight/backend/fit.py:
 * change that file and run the tool. */
#ifndef HUEFLIGHT_FIT_ABI_H
#define HUEFLIGHT_FIT_ABI_H
#include <stdint.h>

#define ABI "5dfa7046ac14912c" /* hash of what follows */

enum { MOST_BANDS = 30 }; /* bands that there is room for */
enum { BLOCK_BINS = 16 }; /* bins of a block */
enum { MOST_NODES = 32 }; /* delays of the posterior that there is room for */
enum { RATIOS = 3 }; /* ratios of peak to background that the search tries */
enum { BACKGROUND_SHARES = 3 }; /* shares of background that it tries */
enum { REFERENCE_MULTIPLE = 16 }; /* of bins of a change reference */
#define LEAST_SHARE 0.001f /* of a band's light in its zone */
#define LEAST_AMPLITUDE 0.002f /* share of all counts */
enum { CENTROID_ROUNDS = 3 }; /* in which the window follows the centroid */

/* Sizes and scales of the tables. */
typedef struct {
    int32_t bands;
    int32_t views;
    int32_t sensor_bins; /* of all views */
    int32_t fine_factor; /* sensor's bins in a fine one */
    int32_t wide_factor; /* fine bins in a wide one */
    int32_t fine_bins;
    int32_t fine_blocks; /* blocks of bins */
    int32_t fine_phases; /* tabulated delays */
    float fine_first_ns; /* first tabulated delay */
    float fine_phase_ns; /* between tabulated delays */
    int32_t wide_bins;
    int32_t wide_blocks; /* blocks of bins */
    int32_t wide_phases; /* tabulated delays */
    float wide_first_ns; /* first tabulated delay */
    float wide_phase_ns; /* between tabulated delays */
    int32_t search_bins;
    int32_t lags;
    int32_t separation; /* lags between which two maxima are two delays */
    float first_lag_ns;
    float lag_ns; /* between lags */
} TableSizes;
_Static_assert(sizeof(TableSizes) == 80, "TableSizes is laid out as NumPy lays it out");

/* Constants of hueflight/fit/reference.py and options of the fit. */
typedef struct {
    float background_shares[3];
    float background_logs[3]; /* their logarithms */
    int32_t steps; /* most steps of scoring at the fine bins */
    int32_t few_steps; /* least steps of pixels with few photons */
    int32_t nodes; /* delays on which the posterior is evaluated */
    int32_t rounds; /* of expectation maximization */
    float settled; /* share of the deviation below which a delay has settled */
    float settled_amplitude; /* the same for amplitudes */
    float floor_photons; /* least background in the weights, photons */
    float floor_share; /* and share of all counts */
    float dark_width; /* least share of bins that tell the background */
    float ridge; /* on the unit diagonal of the normal equations */
    float margin; /* log-likelihood by which a second delay may be worse */
    float raster; /* and per photon */
    float ambiguous; /* log-likelihood by which the better delay must win */
    float few_photons; /* up to which few_steps are taken */
    float posterior_photons; /* up to which the posterior is evaluated */
    float node_spacing; /* between nodes, standard deviations */
    float certain_photons; /* from which detection is not tested */
    float detection_share; /* least share of background in that test */
    int32_t assessed; /* test whether one surface explains the counts */
    float asked; /* score of the screen from which the full test is made */
    float least_background; /* in the weights of these tests, photons */
    float distinct; /* share of a contrast's variance that the other must leave */
    float least_mean; /* expected counts of a group in the deviance */
    int32_t reach; /* tabulated delays to either side in the second derivative */
    int32_t contrasts; /* over wavelength: 0, 1 or 2 */
    float first_log; /* of expected counts in the table of moments */
    float log_step; /* between its points */
    int32_t points; /* of the table of moments */
    float spread_ns; /* deviation of the delay of one photon */
    float low_ns; /* least delay */
    float high_ns; /* greatest delay */
    float target_ns; /* deviation that suffices after the wide bins */
    int32_t starts_wide; /* begin at the wide bins */
    int32_t settle; /* end when a delay has settled */
    int32_t posterior; /* evaluate the posterior of the fewest photons */
} FitRules;
_Static_assert(sizeof(FitRules) == 164, "FitRules is laid out as NumPy lays it out");

/* What all pixels of a correlation share; lags in bins. */
typedef struct {
    double half_width; /* of the centroid's window */
    int32_t search; /* largest lag that is searched */
    int32_t reach; /* half the window in whole bins */
    int32_t most; /* largest lag that the window reaches */
    int32_t circular; /* time repeats after the last bin */
    int32_t bands;
    int32_t outside; /* bins in no window */
} CorrelationSizes;
_Static_assert(sizeof(CorrelationSizes) == 32, "CorrelationSizes is laid out as NumPy lays it out");

/* fit: joint fit, see hueflight/fit/reference.py */
enum {
    FIT_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    FIT_PIXELS = 1, /* int64: rows of counts to work on */
    FIT_SIZES = 2, /* TableSizes */
    FIT_RULES = 3, /* FitRules */
    FIT_VIEW_BINS = 4, /* int32: (view,) sensor's bins */
    FIT_FINE_WIDTHS = 5, /* float32: (block, bin) share of the background */
    FIT_FINE_RUN_PLACES = 6, /* int32: (phase + 1,) first run of each phase */
    FIT_FINE_RUNS = 7, /* int32: (run, 4) band, first bin, bins, place in data */
    FIT_FINE_DATA = 8, /* float32: (place,) of each run all shares, then all slopes */
    FIT_FINE_SEGMENT_PLACES = 9, /* int32: (phase + 1,) first segment of each phase */
    FIT_FINE_SEGMENTS = 10, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    FIT_FINE_LIT = 11, /* int32: (band of a segment, 3) band, places of share and slope */
    FIT_WIDE_WIDTHS = 12, /* float32: (block, bin) share of the background */
    FIT_WIDE_RUN_PLACES = 13, /* int32: (phase + 1,) first run of each phase */
    FIT_WIDE_RUNS = 14, /* int32: (run, 4) band, first bin, bins, place in data */
    FIT_WIDE_DATA = 15, /* float32: (place,) of each run all shares, then all slopes */
    FIT_WIDE_SEGMENT_PLACES = 16, /* int32: (phase + 1,) first segment of each phase */
    FIT_WIDE_SEGMENTS = 17, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    FIT_WIDE_LIT = 18, /* int32: (band of a segment, 3) band, places of share and slope */
    FIT_SEARCH_GAIN_PLACES = 19, /* int32: (lag + 1,) first run of each lag */
    FIT_SEARCH_GAIN_RUNS = 20, /* int32: (run, 4) band, first bin, one past the last, place */
    FIT_SEARCH_GAINS = 21, /* float32: (bin, ratio) of all runs */
    FIT_SEARCH_COSTS = 22, /* float32: (lag, band, share, ratio) */
    FIT_SEARCH_PLACES = 23, /* int32: (lag + 1,) first zone of each lag */
    FIT_SEARCH_RUNS = 24, /* int32: (run, 3) band, first bin, one past the last */
    FIT_SEARCH_WIDTHS = 25, /* float32: (lag, band) share of the background in a band's zone */
    FIT_SEARCH_SHARES = 26, /* float32: (lag, band) share of a band in its zone */
    FIT_OFFSETS = 27, /* float32: (pixel,) delay of each pixel that is fitted */
    FIT_RATES = 28, /* float32: (pixel,) photons per period, or nothing */
    FIT_CONTRASTS = 29, /* float32: (contrast, band) along which delays are tested */
    FIT_CURVATURES = 30, /* float32: (band,) information about width per that about delay */
    FIT_MOMENTS = 31, /* float32: (point, 2) mean and variance of a count's deviance */
    FIT_DELAY_NS = 32, /* float64: (pixel,) */
    FIT_DELAY_STD_NS = 33, /* float64: (pixel,) */
    FIT_OTHER_NS = 34, /* float64: (pixel,) second delay or NaN */
    FIT_AMPLITUDES = 35, /* float64: (pixel, band) */
    FIT_AMPLITUDE_STD = 36, /* float64: (pixel, band) */
    FIT_BACKGROUND = 37, /* float64: (pixel,) */
    FIT_DETECTION = 38, /* float64: (pixel,) twice a log-likelihood ratio, or NaN */
    FIT_CHI_SQUARE = 39, /* float64: (pixel,) per degree of freedom, or NaN */
    FIT_MISFIT = 40, /* float64: (pixel,) greatest score, or NaN */
    FIT_STEPS = 41, /* uint8: (pixel,) */
    FIT_READS = 32,
    FIT_BUFFERS = 42
};

/* change_reference: what later counts are compared with, see hueflight/fit/change_detection.py */
enum {
    CHANGE_REFERENCE_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    CHANGE_REFERENCE_PIXELS = 1, /* int64: rows of counts to work on */
    CHANGE_REFERENCE_SIZES = 2, /* TableSizes */
    CHANGE_REFERENCE_RULES = 3, /* FitRules */
    CHANGE_REFERENCE_VIEW_BINS = 4, /* int32: (view,) sensor's bins */
    CHANGE_REFERENCE_FINE_WIDTHS = 5, /* float32: (block, bin) share of the background */
    CHANGE_REFERENCE_FINE_RUN_PLACES = 6, /* int32: (phase + 1,) first run of each phase */
    CHANGE_REFERENCE_FINE_RUNS = 7, /* int32: (run, 4) band, first bin, bins, place in data */
    CHANGE_REFERENCE_FINE_DATA = 8, /* float32: (place,) of each run all shares, then all slopes */
    CHANGE_REFERENCE_FINE_SEGMENT_PLACES = 9, /* int32: (phase + 1,) first segment of each phase */
    CHANGE_REFERENCE_FINE_SEGMENTS = 10, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGE_REFERENCE_FINE_LIT = 11, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGE_REFERENCE_WIDE_WIDTHS = 12, /* float32: (block, bin) share of the background */
    CHANGE_REFERENCE_WIDE_RUN_PLACES = 13, /* int32: (phase + 1,) first run of each phase */
    CHANGE_REFERENCE_WIDE_RUNS = 14, /* int32: (run, 4) band, first bin, bins, place in data */
    CHANGE_REFERENCE_WIDE_DATA = 15, /* float32: (place,) of each run all shares, then all slopes */
    CHANGE_REFERENCE_WIDE_SEGMENT_PLACES = 16, /* int32: (phase + 1,) first segment of each phase */
    CHANGE_REFERENCE_WIDE_SEGMENTS = 17, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGE_REFERENCE_WIDE_LIT = 18, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGE_REFERENCE_SEARCH_GAIN_PLACES = 19, /* int32: (lag + 1,) first run of each lag */
    CHANGE_REFERENCE_SEARCH_GAIN_RUNS = 20, /* int32: (run, 4) band, first bin, one past the last, place */
    CHANGE_REFERENCE_SEARCH_GAINS = 21, /* float32: (bin, ratio) of all runs */
    CHANGE_REFERENCE_SEARCH_COSTS = 22, /* float32: (lag, band, share, ratio) */
    CHANGE_REFERENCE_SEARCH_PLACES = 23, /* int32: (lag + 1,) first zone of each lag */
    CHANGE_REFERENCE_SEARCH_RUNS = 24, /* int32: (run, 3) band, first bin, one past the last */
    CHANGE_REFERENCE_SEARCH_WIDTHS = 25, /* float32: (lag, band) share of the background in a band's zone */
    CHANGE_REFERENCE_SEARCH_SHARES = 26, /* float32: (lag, band) share of a band in its zone */
    CHANGE_REFERENCE_DELAYS = 27, /* float32: (pixel,) */
    CHANGE_REFERENCE_AMPLITUDES = 28, /* float32: (pixel, band) */
    CHANGE_REFERENCE_BACKGROUND = 29, /* float32: (pixel,) */
    CHANGE_REFERENCE_REFERENCE = 30, /* float32: (pixel, 2, room) */
    CHANGE_REFERENCE_READS = 30,
    CHANGE_REFERENCE_BUFFERS = 31
};

/* change_significance: how much counts have changed, see hueflight/fit/change_detection.py */
enum {
    CHANGE_SIGNIFICANCE_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    CHANGE_SIGNIFICANCE_PIXELS = 1, /* int64: rows of counts to work on */
    CHANGE_SIGNIFICANCE_SIZES = 2, /* TableSizes */
    CHANGE_SIGNIFICANCE_RULES = 3, /* FitRules */
    CHANGE_SIGNIFICANCE_VIEW_BINS = 4, /* int32: (view,) sensor's bins */
    CHANGE_SIGNIFICANCE_FINE_WIDTHS = 5, /* float32: (block, bin) share of the background */
    CHANGE_SIGNIFICANCE_FINE_RUN_PLACES = 6, /* int32: (phase + 1,) first run of each phase */
    CHANGE_SIGNIFICANCE_FINE_RUNS = 7, /* int32: (run, 4) band, first bin, bins, place in data */
    CHANGE_SIGNIFICANCE_FINE_DATA = 8, /* float32: (place,) of each run all shares, then all slopes */
    CHANGE_SIGNIFICANCE_FINE_SEGMENT_PLACES = 9, /* int32: (phase + 1,) first segment of each phase */
    CHANGE_SIGNIFICANCE_FINE_SEGMENTS = 10, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGE_SIGNIFICANCE_FINE_LIT = 11, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGE_SIGNIFICANCE_WIDE_WIDTHS = 12, /* float32: (block, bin) share of the background */
    CHANGE_SIGNIFICANCE_WIDE_RUN_PLACES = 13, /* int32: (phase + 1,) first run of each phase */
    CHANGE_SIGNIFICANCE_WIDE_RUNS = 14, /* int32: (run, 4) band, first bin, bins, place in data */
    CHANGE_SIGNIFICANCE_WIDE_DATA = 15, /* float32: (place,) of each run all shares, then all slopes */
    CHANGE_SIGNIFICANCE_WIDE_SEGMENT_PLACES = 16, /* int32: (phase + 1,) first segment of each phase */
    CHANGE_SIGNIFICANCE_WIDE_SEGMENTS = 17, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGE_SIGNIFICANCE_WIDE_LIT = 18, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGE_SIGNIFICANCE_SEARCH_GAIN_PLACES = 19, /* int32: (lag + 1,) first run of each lag */
    CHANGE_SIGNIFICANCE_SEARCH_GAIN_RUNS = 20, /* int32: (run, 4) band, first bin, one past the last, place */
    CHANGE_SIGNIFICANCE_SEARCH_GAINS = 21, /* float32: (bin, ratio) of all runs */
    CHANGE_SIGNIFICANCE_SEARCH_COSTS = 22, /* float32: (lag, band, share, ratio) */
    CHANGE_SIGNIFICANCE_SEARCH_PLACES = 23, /* int32: (lag + 1,) first zone of each lag */
    CHANGE_SIGNIFICANCE_SEARCH_RUNS = 24, /* int32: (run, 3) band, first bin, one past the last */
    CHANGE_SIGNIFICANCE_SEARCH_WIDTHS = 25, /* float32: (lag, band) share of the background in a band's zone */
    CHANGE_SIGNIFICANCE_SEARCH_SHARES = 26, /* float32: (lag, band) share of a band in its zone */
    CHANGE_SIGNIFICANCE_DELAYS = 27, /* float32: (pixel,) */
    CHANGE_SIGNIFICANCE_SCALES = 28, /* float32: (pixel,) exposures now per exposure then */
    CHANGE_SIGNIFICANCE_REFERENCE = 29, /* float32: (pixel of counts, 2, room) */
    CHANGE_SIGNIFICANCE_SIGNIFICANCE = 30, /* float32: (pixel,) */
    CHANGE_SIGNIFICANCE_READS = 30,
    CHANGE_SIGNIFICANCE_BUFFERS = 31
};

/* sums: counts of pixels */
enum {
    SUMS_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    SUMS_PIXELS = 1, /* int64: rows of counts to work on */
    SUMS_SPAN = 2, /* int64: (2,) first bin and one past the last of those that count */
    SUMS_ALL = 3, /* float64: (pixel,) counts of all bins */
    SUMS_INSIDE = 4, /* float64: (pixel,) counts of the span */
    SUMS_FULL = 5, /* uint8: (pixel,) a counter is at the end of its type */
    SUMS_READS = 3,
    SUMS_BUFFERS = 6
};

/* correlations: the published method, see hueflight/reconstruction/paper.py */
enum {
    CORRELATIONS_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    CORRELATIONS_PIXELS = 1, /* int64: rows of counts to work on */
    CORRELATIONS_SIZES = 2, /* CorrelationSizes */
    CORRELATIONS_WINDOWS = 3, /* int32: (window, 3) band, first bin, one past the last */
    CORRELATIONS_GAPS = 4, /* int32: (gap, 2) first bin and one past the last of bins in no window */
    CORRELATIONS_REFERENCE = 5, /* uint16: (pixel of counts, bin) continued around by the largest lag */
    CORRELATIONS_PIXEL_DELAYS = 6, /* float64: (pixel of counts,) */
    CORRELATIONS_DELAY = 7, /* float64: (pixel,) in bins */
    CORRELATIONS_DEVIATION = 8, /* float64: (pixel,) in bins */
    CORRELATIONS_WINDOW_SUMS = 9, /* float64: (pixel, band) */
    CORRELATIONS_BACKGROUND = 10, /* float64: (pixel,) counts per code */
    CORRELATIONS_READS = 7,
    CORRELATIONS_BUFFERS = 11
};

#endif
