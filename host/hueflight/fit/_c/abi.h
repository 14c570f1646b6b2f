/* SPDX-License-Identifier: Apache-2.0 */
/* Made by tools/generate_kernel_headers.py from hueflight/backend/fit.py:
 * change that file and run the tool. */
#ifndef HUEFLIGHT_FIT_ABI_H
#define HUEFLIGHT_FIT_ABI_H
#include <stdint.h>

#define ABI "badb9a43212077a4" /* hash of what follows */

enum { MOST_BANDS = 30 }; /* bands that there is room for */
enum { BLOCK_BINS = 16 }; /* bins of a block */
enum { MOST_NODES = 32 }; /* delays of the posterior that there is room for */
enum { RATIOS = 3 }; /* ratios of peak to background that the search tries */
enum { BACKGROUND_SHARES = 3 }; /* shares of background that it tries */
enum { REFERENCE_MULTIPLE = 16 }; /* of bins of a change reference */
enum { MOST_WEIGHT = 127 }; /* of a bin of a change reference */
enum { LUCK_CELLS = 256 }; /* of heights above a limit */
#define LEAST_SHARE 0.001f /* of a band's light in its zone */
#define LEAST_AMPLITUDE 0.002f /* share of all counts */
enum { CENTROID_ROUNDS = 3 }; /* in which the window follows the centroid */
enum { RESULT_PLANES = 8 }; /* numbers of a pixel besides its reflectances */
enum { INFORMATION_COLUMNS = 4 }; /* of the table of information */
enum { WINDOW = 5 }; /* rows and columns of the window about a pixel */

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
    float fine_whole; /* share of the background in all bins */
    int32_t wide_bins;
    int32_t wide_blocks; /* blocks of bins */
    int32_t wide_phases; /* tabulated delays */
    float wide_first_ns; /* first tabulated delay */
    float wide_phase_ns; /* between tabulated delays */
    float wide_whole; /* share of the background in all bins */
    int32_t search_bins;
    int32_t lags;
    int32_t separation; /* lags between which two maxima are two delays */
    float first_lag_ns;
    float lag_ns; /* between lags */
} TableSizes;
_Static_assert(sizeof(TableSizes) == 88, "TableSizes is laid out as NumPy lays it out");

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
    int32_t lag; /* tabulated delays by which some light is earlier or later */
    float first_broadening; /* of pulses, with delays along the first contrast, ns */
    float second_broadening; /* and along the second */
    float lag_allowance; /* subtracted from scores of earlier or later light, */
    float first_allowance; /* of delays along the first contrast, */
    float second_allowance; /* along the second, */
    float deviance_allowance; /* and of the deviance */
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
_Static_assert(sizeof(FitRules) == 192, "FitRules is laid out as NumPy lays it out");

/* What all pixels of a correlation share; lags in bins. */
typedef struct {
    double half_width; /* of the centroid's window */
    double highest; /* count of all references */
    int32_t search; /* largest lag that is searched */
    int32_t reach; /* half the window in whole bins */
    int32_t most; /* largest lag that the window reaches */
    int32_t circular; /* time repeats after the last bin */
    int32_t bands;
    int32_t outside; /* bins in no window */
} CorrelationSizes;
_Static_assert(sizeof(CorrelationSizes) == 40, "CorrelationSizes is laid out as NumPy lays it out");

/* Ratios of a band's photons to background at which tables are given. */
typedef struct {
    int32_t points; /* of the tables */
    float least; /* ratio */
    float first_log; /* its natural logarithm */
    float per_log; /* points per unit of the logarithm */
} InformationScale;
_Static_assert(sizeof(InformationScale) == 16, "InformationScale is laid out as NumPy lays it out");

/* Constants of hueflight/reconstruction/conversion.py, and what all pixels of a picture share. */
typedef struct {
    double distance; /* of the reference, m */
    double blind_ns; /* deviation of who knows nothing */
    double least_detection; /* ratio from which there is a surface */
    double low_ns; /* delay up to which it was cut off */
    double high_ns; /* delay from which it was */
    double misfit_limit; /* score that is flagged */
    double plain_misfit; /* chi-square that is counted as great */
    double misfit; /* factor of the variance of photon noise */
    double brightness; /* of all bands together */
    double background_scale; /* from all bins to one code */
    double periods; /* of an exposure */
    double fewest_exposures; /* fewer are none */
    double most_closed; /* share of exposures that may hold a photon */
    double least_empty; /* share of exposures that must be empty */
    double least_bias; /* share of the information that makes no difference */
    double most_bias; /* share that is taken back at most */
    double cells_per_height; /* of luck_cells */
    double first_tail; /* score of the first tail */
    double tail_step; /* between scores */
    double last_tail; /* score from which the probability is 0 */
    int32_t pixels; /* of the picture */
    int32_t counted; /* the exposures are those of the counts */
    int32_t scaled; /* light is that of one exposure */
    int32_t pileup_correction;
    int32_t range_correction;
    int32_t low_signal; /* flags of quality */
    int32_t saturated;
    int32_t ambiguous;
    int32_t no_return;
    int32_t out_of_range;
    int32_t misfit_flag;
    int32_t piled_up;
} PictureRules;
_Static_assert(sizeof(PictureRules) == 208, "PictureRules is laid out as NumPy lays it out");

/* Shape of a picture, and how far apart the pixels of a surface are. */
typedef struct {
    int32_t rows;
    int32_t cols;
    float reach; /* standard deviations */
} PictureSize;
_Static_assert(sizeof(PictureSize) == 12, "PictureSize is laid out as NumPy lays it out");

/* fit: joint fit, see hueflight/fit/reference.py */
enum {
    FIT_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    FIT_PIXELS = 1, /* int64: rows of counts to work on */
    FIT_SIZES = 2, /* TableSizes */
    FIT_RULES = 3, /* FitRules */
    FIT_VIEW_BINS = 4, /* int32: (view,) sensor's bins */
    FIT_FINE_WIDTHS = 5, /* float32: (block, bin) share of the background */
    FIT_FINE_RUN_PLACES = 6, /* int32: (phase + 1,) first run of each phase */
    FIT_FINE_RUNS = 7, /* int32: (run, 6) band, first bin, bins, place; first lit bin, bins */
    FIT_FINE_DATA = 8, /* float32: (place,) of each run all shares, then all slopes */
    FIT_FINE_SEGMENT_PLACES = 9, /* int32: (phase + 1,) first segment of each phase */
    FIT_FINE_SEGMENTS = 10, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    FIT_FINE_LIT = 11, /* int32: (band of a segment, 3) band, places of share and slope */
    FIT_FINE_SUMS = 12, /* float32: (phase, band, 2) of shares and slopes, over bins */
    FIT_WIDE_WIDTHS = 13, /* float32: (block, bin) share of the background */
    FIT_WIDE_RUN_PLACES = 14, /* int32: (phase + 1,) first run of each phase */
    FIT_WIDE_RUNS = 15, /* int32: (run, 6) band, first bin, bins, place; first lit bin, bins */
    FIT_WIDE_DATA = 16, /* float32: (place,) of each run all shares, then all slopes */
    FIT_WIDE_SEGMENT_PLACES = 17, /* int32: (phase + 1,) first segment of each phase */
    FIT_WIDE_SEGMENTS = 18, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    FIT_WIDE_LIT = 19, /* int32: (band of a segment, 3) band, places of share and slope */
    FIT_WIDE_SUMS = 20, /* float32: (phase, band, 2) of shares and slopes, over bins */
    FIT_SEARCH_GAIN_PLACES = 21, /* int32: (lag + 1,) first run of each lag */
    FIT_SEARCH_GAIN_RUNS = 22, /* int32: (run, 4) band, first bin, one past the last, place */
    FIT_SEARCH_GAINS = 23, /* float32: (bin, ratio) of all runs */
    FIT_SEARCH_COSTS = 24, /* float32: (lag, band, share, ratio) */
    FIT_SEARCH_PLACES = 25, /* int32: (lag + 1,) first zone of each lag */
    FIT_SEARCH_RUNS = 26, /* int32: (run, 3) band, first bin, one past the last */
    FIT_SEARCH_WIDTHS = 27, /* float32: (lag, band) share of the background in a band's zone */
    FIT_SEARCH_SHARES = 28, /* float32: (lag, band) share of a band in its zone */
    FIT_OFFSETS = 29, /* float32: (pixel,) delay of each pixel that is fitted */
    FIT_RATES = 30, /* float32: (pixel,) photons per period, or nothing */
    FIT_CONTRASTS = 31, /* float32: (contrast, band) along which delays are tested */
    FIT_CURVATURES = 32, /* float32: (band,) information about width per that about delay */
    FIT_MOMENTS = 33, /* float32: (point, 2) mean and variance of a count's deviance */
    FIT_DELAY_NS = 34, /* float64: (pixel,) */
    FIT_DELAY_STD_NS = 35, /* float64: (pixel,) */
    FIT_OTHER_NS = 36, /* float64: (pixel,) second delay or NaN */
    FIT_AMPLITUDES = 37, /* float64: (pixel, band) */
    FIT_AMPLITUDE_STD = 38, /* float64: (pixel, band) */
    FIT_BACKGROUND = 39, /* float64: (pixel,) */
    FIT_DETECTION = 40, /* float64: (pixel,) twice a log-likelihood ratio, or NaN */
    FIT_CHI_SQUARE = 41, /* float64: (pixel,) per degree of freedom, or NaN */
    FIT_MISFIT = 42, /* float64: (pixel,) greatest score, or NaN */
    FIT_STEPS = 43, /* uint8: (pixel,) */
    FIT_READS = 34,
    FIT_BUFFERS = 44
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
    CHANGE_REFERENCE_FINE_RUNS = 7, /* int32: (run, 6) band, first bin, bins, place; first lit bin, bins */
    CHANGE_REFERENCE_FINE_DATA = 8, /* float32: (place,) of each run all shares, then all slopes */
    CHANGE_REFERENCE_FINE_SEGMENT_PLACES = 9, /* int32: (phase + 1,) first segment of each phase */
    CHANGE_REFERENCE_FINE_SEGMENTS = 10, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGE_REFERENCE_FINE_LIT = 11, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGE_REFERENCE_FINE_SUMS = 12, /* float32: (phase, band, 2) of shares and slopes, over bins */
    CHANGE_REFERENCE_WIDE_WIDTHS = 13, /* float32: (block, bin) share of the background */
    CHANGE_REFERENCE_WIDE_RUN_PLACES = 14, /* int32: (phase + 1,) first run of each phase */
    CHANGE_REFERENCE_WIDE_RUNS = 15, /* int32: (run, 6) band, first bin, bins, place; first lit bin, bins */
    CHANGE_REFERENCE_WIDE_DATA = 16, /* float32: (place,) of each run all shares, then all slopes */
    CHANGE_REFERENCE_WIDE_SEGMENT_PLACES = 17, /* int32: (phase + 1,) first segment of each phase */
    CHANGE_REFERENCE_WIDE_SEGMENTS = 18, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGE_REFERENCE_WIDE_LIT = 19, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGE_REFERENCE_WIDE_SUMS = 20, /* float32: (phase, band, 2) of shares and slopes, over bins */
    CHANGE_REFERENCE_SEARCH_GAIN_PLACES = 21, /* int32: (lag + 1,) first run of each lag */
    CHANGE_REFERENCE_SEARCH_GAIN_RUNS = 22, /* int32: (run, 4) band, first bin, one past the last, place */
    CHANGE_REFERENCE_SEARCH_GAINS = 23, /* float32: (bin, ratio) of all runs */
    CHANGE_REFERENCE_SEARCH_COSTS = 24, /* float32: (lag, band, share, ratio) */
    CHANGE_REFERENCE_SEARCH_PLACES = 25, /* int32: (lag + 1,) first zone of each lag */
    CHANGE_REFERENCE_SEARCH_RUNS = 26, /* int32: (run, 3) band, first bin, one past the last */
    CHANGE_REFERENCE_SEARCH_WIDTHS = 27, /* float32: (lag, band) share of the background in a band's zone */
    CHANGE_REFERENCE_SEARCH_SHARES = 28, /* float32: (lag, band) share of a band in its zone */
    CHANGE_REFERENCE_DELAYS = 29, /* float32: (pixel,) */
    CHANGE_REFERENCE_AMPLITUDES = 30, /* float32: (pixel, band) */
    CHANGE_REFERENCE_BACKGROUND = 31, /* float32: (pixel,) */
    CHANGE_REFERENCE_WEIGHTS = 32, /* int8: (pixel, room) */
    CHANGE_REFERENCE_SUMS = 33, /* float32: (pixel, 3 + band) */
    CHANGE_REFERENCE_READS = 32,
    CHANGE_REFERENCE_BUFFERS = 34
};

/* changes: sums of pixels and how much their light has changed, see hueflight/fit/change_detection.py */
enum {
    CHANGES_COUNTS = 0, /* counts: (pixel, bin) in time order, uint16, uint32 or float32 */
    CHANGES_PIXELS = 1, /* int64: rows of counts to work on */
    CHANGES_SIZES = 2, /* TableSizes */
    CHANGES_RULES = 3, /* FitRules */
    CHANGES_VIEW_BINS = 4, /* int32: (view,) sensor's bins */
    CHANGES_FINE_WIDTHS = 5, /* float32: (block, bin) share of the background */
    CHANGES_FINE_RUN_PLACES = 6, /* int32: (phase + 1,) first run of each phase */
    CHANGES_FINE_RUNS = 7, /* int32: (run, 6) band, first bin, bins, place; first lit bin, bins */
    CHANGES_FINE_DATA = 8, /* float32: (place,) of each run all shares, then all slopes */
    CHANGES_FINE_SEGMENT_PLACES = 9, /* int32: (phase + 1,) first segment of each phase */
    CHANGES_FINE_SEGMENTS = 10, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGES_FINE_LIT = 11, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGES_FINE_SUMS = 12, /* float32: (phase, band, 2) of shares and slopes, over bins */
    CHANGES_WIDE_WIDTHS = 13, /* float32: (block, bin) share of the background */
    CHANGES_WIDE_RUN_PLACES = 14, /* int32: (phase + 1,) first run of each phase */
    CHANGES_WIDE_RUNS = 15, /* int32: (run, 6) band, first bin, bins, place; first lit bin, bins */
    CHANGES_WIDE_DATA = 16, /* float32: (place,) of each run all shares, then all slopes */
    CHANGES_WIDE_SEGMENT_PLACES = 17, /* int32: (phase + 1,) first segment of each phase */
    CHANGES_WIDE_SEGMENTS = 18, /* int32: (segment, 4) first bin, bins, bands, first of lit */
    CHANGES_WIDE_LIT = 19, /* int32: (band of a segment, 3) band, places of share and slope */
    CHANGES_WIDE_SUMS = 20, /* float32: (phase, band, 2) of shares and slopes, over bins */
    CHANGES_SEARCH_GAIN_PLACES = 21, /* int32: (lag + 1,) first run of each lag */
    CHANGES_SEARCH_GAIN_RUNS = 22, /* int32: (run, 4) band, first bin, one past the last, place */
    CHANGES_SEARCH_GAINS = 23, /* float32: (bin, ratio) of all runs */
    CHANGES_SEARCH_COSTS = 24, /* float32: (lag, band, share, ratio) */
    CHANGES_SEARCH_PLACES = 25, /* int32: (lag + 1,) first zone of each lag */
    CHANGES_SEARCH_RUNS = 26, /* int32: (run, 3) band, first bin, one past the last */
    CHANGES_SEARCH_WIDTHS = 27, /* float32: (lag, band) share of the background in a band's zone */
    CHANGES_SEARCH_SHARES = 28, /* float32: (lag, band) share of a band in its zone */
    CHANGES_SPAN = 29, /* int64: (3,) first bin of light, one past its last, 1 if in reverse */
    CHANGES_EXPOSURES = 30, /* float64: (pixel of counts,) now, or () for the counts of all bins */
    CHANGES_EARLIER = 31, /* float64: (pixel of counts,) at the fit, or () for as many as now */
    CHANGES_DELAYS = 32, /* float32: (pixel of counts,) */
    CHANGES_WEIGHTS = 33, /* int8: (pixel of counts, room) */
    CHANGES_KEPT = 34, /* float32: (pixel of counts, 3 + band) sums of the fit */
    CHANGES_ALL = 35, /* float64: (pixel,) counts of all bins */
    CHANGES_INSIDE = 36, /* float64: (pixel,) counts of the span */
    CHANGES_FULL = 37, /* uint8: (pixel,) a counter is at the end of its type */
    CHANGES_SIGNIFICANCE = 38, /* float32: (pixel,) */
    CHANGES_READS = 35,
    CHANGES_BUFFERS = 39
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

/* verdicts: flags of fits, see hueflight/reconstruction/conversion.py */
enum {
    VERDICTS_RULES = 0, /* PictureRules */
    VERDICTS_DELAY_NS = 1, /* float64: (fit,) */
    VERDICTS_DELAY_STD_NS = 2, /* float64: (fit,) */
    VERDICTS_OTHER_NS = 3, /* float64: (fit,) second delay or NaN */
    VERDICTS_DETECTION = 4, /* float64: (fit,) twice a log-likelihood ratio, or NaN */
    VERDICTS_CHI_SQUARE = 5, /* float64: (fit,) per degree of freedom, or NaN */
    VERDICTS_MISFIT = 6, /* float64: (fit,) greatest score, or NaN */
    VERDICTS_METERS_PER_NS = 7, /* float64: (fit,) depth per delay */
    VERDICTS_FLAGS = 8, /* uint16: (fit,) */
    VERDICTS_TALLY = 9, /* int64: (3,) told chi-squares, those above 1, those that are great */
    VERDICTS_READS = 8,
    VERDICTS_BUFFERS = 10
};

/* picture: results of pixels at their places in a picture, see hueflight/reconstruction/conversion.py */
enum {
    PICTURE_RULES = 0, /* PictureRules */
    PICTURE_DELAY_NS = 1, /* float64: (fit,) */
    PICTURE_DELAY_STD_NS = 2, /* float64: (fit,) */
    PICTURE_OTHER_NS = 3, /* float64: (fit,) second delay or NaN */
    PICTURE_DETECTION = 4, /* float64: (fit,) twice a log-likelihood ratio, or NaN */
    PICTURE_CHI_SQUARE = 5, /* float64: (fit,) per degree of freedom, or NaN */
    PICTURE_MISFIT = 6, /* float64: (fit,) greatest score, or NaN */
    PICTURE_FLAGS = 7, /* uint16: (fit,) of verdicts */
    PICTURE_AMPLITUDES = 8, /* float64: (fit, band) photons */
    PICTURE_AMPLITUDE_STD = 9, /* float64: (fit, band) */
    PICTURE_BACKGROUND = 10, /* float64: (fit,) photons */
    PICTURE_PLACES = 11, /* int64: (pixel,) in the picture */
    PICTURE_FITS = 12, /* int64: (pixel,) number of its fit, rising by 1, or -1 */
    PICTURE_PHOTONS = 13, /* float64: (place,) */
    PICTURE_EXPOSURES = 14, /* float64: (place,) if light is scaled or exposures are counted */
    PICTURE_BASE = 15, /* uint16: (place,) flags of the calibration */
    PICTURE_METERS_PER_NS = 16, /* float64: (place,) depth per delay */
    PICTURE_DELAY_VARIANCE = 17, /* float64: (place,) of the calibration, ns2 */
    PICTURE_BRIGHTNESS_VARIANCE = 18, /* float64: (place,) relative */
    PICTURE_FLAT_FIELD = 19, /* float64: (place,) */
    PICTURE_REFERENCE_LOSS = 20, /* float64: (place,) without pile-up correction: of photons */
    PICTURE_INVERSE = 21, /* float64: (band,) 1 / brightness */
    PICTURE_UNCERTAINTY = 22, /* float64: (band,) relative variance of the brightness */
    PICTURE_SCALE = 23, /* InformationScale */
    PICTURE_TABLE = 24, /* float32: (ratio, band, column) information on the delay, its step to the next ratio, half its second derivative, its step */
    PICTURE_PLACEMENT = 25, /* float32: (band,) variance of a waveform's place in time */
    PICTURE_LUCK = 26, /* float64: (2, point) rising heights above a limit, and the limits */
    PICTURE_LUCK_CELLS = 27, /* int32: (cell,) last limit at or before it */
    PICTURE_TAILS = 28, /* float64: (score,) logarithms of probabilities */
    PICTURE_NUMBERS = 29, /* float64: (plane, place) in the order of result_planes.py */
    PICTURE_REFLECTANCES = 30, /* float32: (2, place, band) values and deviations */
    PICTURE_QUALITY = 31, /* uint16: (place,) */
    PICTURE_READS = 29,
    PICTURE_BUFFERS = 32
};

/* surface_starts: where surfaces about a pixel are looked for, see hueflight/reconstruction/edges.py */
enum {
    SURFACE_STARTS_DEPTH = 0, /* float32: (row, col) or NaN */
    SURFACE_STARTS_DEVIATION = 1, /* float32: (row, col) */
    SURFACE_STARTS_SIZE = 2, /* PictureSize */
    SURFACE_STARTS_NEAR = 3, /* float32: (row, col) of pixels with a whole window */
    SURFACE_STARTS_FAR = 4, /* float32: the same */
    SURFACE_STARTS_READS = 3,
    SURFACE_STARTS_BUFFERS = 5
};

#endif
