# SPDX-License-Identifier: Apache-2.0
"""Interface of the compiled joint fit, change detection and correlation."""

from hueflight.backend.fit_results import (
    INFORMATION_COLUMNS,
    INFORMATION_SCALE,
    LUCK_CELLS,
    PICTURE,
    PICTURE_RULES,
    PICTURE_SIZE,
    RESULT_PLANES,
    SURFACE_STARTS,
    VERDICTS,
    WINDOW,
)
from hueflight.backend.interface import (
    COUNTS,
    Buffer,
    Constant,
    Field,
    Function,
    Interface,
    Record,
)

MOST_BANDS = 30  #: bands that the compiled fit has room for
BLOCK_BINS = 16  #: bins of a block; a multiple of the lanes of every build
MOST_NODES = 32  #: delays of the posterior that it has room for
RATIOS = 3  #: ratios of a band's peak to the background that the search tries
BACKGROUND_SHARES = 3  #: shares of background that the search tries
MOST_WEIGHT = 127  #: of a bin of a change reference
REFERENCE_MULTIPLE = 16  #: bins of a change reference are made up to a multiple of this
LEAST_SHARE = 1e-3  #: least share of a band's light in its zone that is divided by
LEAST_AMPLITUDE = 0.002  #: share of all counts from which likelihoods of amplitudes start
CENTROID_ROUNDS = 3  #: in which the window of the centroid follows it


def _level_fields(level: str) -> tuple[Field, ...]:
    return (
        Field(f"{level}_bins", "int32"),
        Field(f"{level}_blocks", "int32", "blocks of bins"),
        Field(f"{level}_phases", "int32", "tabulated delays"),
        Field(f"{level}_first_ns", "float32", "first tabulated delay"),
        Field(f"{level}_phase_ns", "float32", "between tabulated delays"),
        Field(f"{level}_whole", "float32", "share of the background in all bins"),
    )


TABLE_SIZES = Record(
    "TableSizes",
    "Sizes and scales of the tables.",
    (
        Field("bands", "int32"),
        Field("views", "int32"),
        Field("sensor_bins", "int32", "of all views"),
        Field("fine_factor", "int32", "sensor's bins in a fine one"),
        Field("wide_factor", "int32", "fine bins in a wide one"),
        *_level_fields("fine"),
        *_level_fields("wide"),
        Field("search_bins", "int32"),
        Field("lags", "int32"),
        Field("separation", "int32", "lags between which two maxima are two delays"),
        Field("first_lag_ns", "float32"),
        Field("lag_ns", "float32", "between lags"),
    ),
)
FIT_RULES = Record(
    "FitRules",
    "Constants of hueflight/fit/reference.py and options of the fit.",
    (
        Field("background_shares", "float32", size=BACKGROUND_SHARES),
        Field("background_logs", "float32", "their logarithms", size=BACKGROUND_SHARES),
        Field("steps", "int32", "most steps of scoring at the fine bins"),
        Field("few_steps", "int32", "least steps of pixels with few photons"),
        Field("nodes", "int32", "delays on which the posterior is evaluated"),
        Field("rounds", "int32", "of expectation maximization"),
        Field("settled", "float32", "share of the deviation below which a delay has settled"),
        Field("settled_amplitude", "float32", "the same for amplitudes"),
        Field("floor_photons", "float32", "least background in the weights, photons"),
        Field("floor_share", "float32", "and share of all counts"),
        Field("dark_width", "float32", "least share of bins that tell the background"),
        Field("ridge", "float32", "on the unit diagonal of the normal equations"),
        Field("margin", "float32", "log-likelihood by which a second delay may be worse"),
        Field("raster", "float32", "and per photon"),
        Field("ambiguous", "float32", "log-likelihood by which the better delay must win"),
        Field("few_photons", "float32", "up to which few_steps are taken"),
        Field("posterior_photons", "float32", "up to which the posterior is evaluated"),
        Field("node_spacing", "float32", "between nodes, standard deviations"),
        Field("certain_photons", "float32", "from which detection is not tested"),
        Field("detection_share", "float32", "least share of background in that test"),
        Field("assessed", "int32", "test whether one surface explains the counts"),
        Field("asked", "float32", "score of the screen from which the full test is made"),
        Field("least_background", "float32", "in the weights of these tests, photons"),
        Field("distinct", "float32", "share of a contrast's variance that the other must leave"),
        Field("least_mean", "float32", "expected counts of a group in the deviance"),
        Field("reach", "int32", "tabulated delays to either side in the second derivative"),
        Field("contrasts", "int32", "over wavelength: 0, 1 or 2"),
        Field("lag", "int32", "tabulated delays by which some light is earlier or later"),
        Field("first_broadening", "float32", "of pulses, with delays along the first contrast, ns"),
        Field("second_broadening", "float32", "and along the second"),
        Field("lag_allowance", "float32", "subtracted from scores of earlier or later light,"),
        Field("first_allowance", "float32", "of delays along the first contrast,"),
        Field("second_allowance", "float32", "along the second,"),
        Field("deviance_allowance", "float32", "and of the deviance"),
        Field("first_log", "float32", "of expected counts in the table of moments"),
        Field("log_step", "float32", "between its points"),
        Field("points", "int32", "of the table of moments"),
        Field("spread_ns", "float32", "deviation of the delay of one photon"),
        Field("low_ns", "float32", "least delay"),
        Field("high_ns", "float32", "greatest delay"),
        Field("target_ns", "float32", "deviation that suffices after the wide bins"),
        Field("starts_wide", "int32", "begin at the wide bins"),
        Field("settle", "int32", "end when a delay has settled"),
        Field("posterior", "int32", "evaluate the posterior of the fewest photons"),
    ),
)


def _level_buffers(level: str) -> tuple[Buffer, ...]:
    return (
        Buffer(f"{level}_widths", "float32", "(block, bin) share of the background"),
        Buffer(f"{level}_run_places", "int32", "(phase + 1,) first run of each phase"),
        Buffer(
            f"{level}_runs", "int32", "(run, 6) band, first bin, bins, place; first lit bin, bins"
        ),
        Buffer(f"{level}_data", "float32", "(place,) of each run all shares, then all slopes"),
        Buffer(f"{level}_segment_places", "int32", "(phase + 1,) first segment of each phase"),
        Buffer(f"{level}_segments", "int32", "(segment, 4) first bin, bins, bands, first of lit"),
        Buffer(f"{level}_lit", "int32", "(band of a segment, 3) band, places of share and slope"),
        Buffer(f"{level}_sums", "float32", "(phase, band, 2) of shares and slopes, over bins"),
    )


TABLES = (
    Buffer("sizes", TABLE_SIZES),
    Buffer("rules", FIT_RULES),
    Buffer("view_bins", "int32", "(view,) sensor's bins"),
    *_level_buffers("fine"),
    *_level_buffers("wide"),
    Buffer("search_gain_places", "int32", "(lag + 1,) first run of each lag"),
    Buffer("search_gain_runs", "int32", "(run, 4) band, first bin, one past the last, place"),
    Buffer("search_gains", "float32", "(bin, ratio) of all runs"),
    Buffer("search_costs", "float32", "(lag, band, share, ratio)"),
    Buffer("search_places", "int32", "(lag + 1,) first zone of each lag"),
    Buffer("search_runs", "int32", "(run, 3) band, first bin, one past the last"),
    Buffer("search_widths", "float32", "(lag, band) share of the background in a band's zone"),
    Buffer("search_shares", "float32", "(lag, band) share of a band in its zone"),
)
PIXELS = (
    Buffer("counts", COUNTS, "(pixel, bin) in time order, uint16, uint32 or float32"),
    Buffer("pixels", "int64", "rows of counts to work on"),
)

FIT = Function(
    "fit",
    "joint fit, see hueflight/fit/reference.py",
    (
        *PIXELS,
        *TABLES,
        Buffer("offsets", "float32", "(pixel,) delay of each pixel that is fitted"),
        Buffer("rates", "float32", "(pixel,) photons per period, or nothing"),
        Buffer("contrasts", "float32", "(contrast, band) along which delays are tested"),
        Buffer("curvatures", "float32", "(band,) information about width per that about delay"),
        Buffer("moments", "float32", "(point, 2) mean and variance of a count's deviance"),
    ),
    (
        Buffer("delay_ns", "float64", "(pixel,)"),
        Buffer("delay_std_ns", "float64", "(pixel,)"),
        Buffer("other_ns", "float64", "(pixel,) second delay or NaN"),
        Buffer("amplitudes", "float64", "(pixel, band)"),
        Buffer("amplitude_std", "float64", "(pixel, band)"),
        Buffer("background", "float64", "(pixel,)"),
        Buffer("detection", "float64", "(pixel,) twice a log-likelihood ratio, or NaN"),
        Buffer("chi_square", "float64", "(pixel,) per degree of freedom, or NaN"),
        Buffer("misfit", "float64", "(pixel,) greatest score, or NaN"),
        Buffer("steps", "uint8", "(pixel,)"),
    ),
)
CHANGE_REFERENCE = Function(
    "change_reference",
    "what later counts are compared with, see hueflight/fit/change_detection.py",
    (
        *PIXELS,
        *TABLES,
        Buffer("delays", "float32", "(pixel,)"),
        Buffer("amplitudes", "float32", "(pixel, band)"),
        Buffer("background", "float32", "(pixel,)"),
    ),
    (
        Buffer("weights", "int8", "(pixel, room)"),
        Buffer("sums", "float32", "(pixel, 3 + band)"),
    ),
)
CHANGES = Function(
    "changes",
    "sums of pixels and how much their light has changed, see hueflight/fit/change_detection.py",
    (
        *PIXELS,
        *TABLES,
        Buffer("span", "int64", "(3,) first bin of light, one past its last, 1 if in reverse"),
        Buffer("exposures", "float64", "(pixel of counts,) now, or () for the counts of all bins"),
        Buffer("earlier", "float64", "(pixel of counts,) at the fit, or () for as many as now"),
        Buffer("delays", "float32", "(pixel of counts,)"),
        Buffer("weights", "int8", "(pixel of counts, room)"),
        Buffer("kept", "float32", "(pixel of counts, 3 + band) sums of the fit"),
    ),
    (
        Buffer("all", "float64", "(pixel,) counts of all bins"),
        Buffer("inside", "float64", "(pixel,) counts of the span"),
        Buffer("full", "uint8", "(pixel,) a counter is at the end of its type"),
        Buffer("significance", "float32", "(pixel,)"),
    ),
)
SUMS = Function(
    "sums",
    "counts of pixels",
    (*PIXELS, Buffer("span", "int64", "(2,) first bin and one past the last of those that count")),
    (
        Buffer("all", "float64", "(pixel,) counts of all bins"),
        Buffer("inside", "float64", "(pixel,) counts of the span"),
        Buffer("full", "uint8", "(pixel,) a counter is at the end of its type"),
    ),
)
CORRELATION_SIZES = Record(
    "CorrelationSizes",
    "What all pixels of a correlation share; lags in bins.",
    (
        Field("half_width", "float64", "of the centroid's window"),
        Field("highest", "float64", "count of all references"),
        Field("search", "int32", "largest lag that is searched"),
        Field("reach", "int32", "half the window in whole bins"),
        Field("most", "int32", "largest lag that the window reaches"),
        Field("circular", "int32", "time repeats after the last bin"),
        Field("bands", "int32"),
        Field("outside", "int32", "bins in no window"),
    ),
)
CORRELATIONS = Function(
    "correlations",
    "the published method, see hueflight/reconstruction/paper.py",
    (
        *PIXELS,
        Buffer("sizes", CORRELATION_SIZES),
        Buffer("windows", "int32", "(window, 3) band, first bin, one past the last"),
        Buffer("gaps", "int32", "(gap, 2) first bin and one past the last of bins in no window"),
        Buffer("reference", "uint16", "(pixel of counts, bin) continued around by the largest lag"),
        Buffer("pixel_delays", "float64", "(pixel of counts,)"),
    ),
    (
        Buffer("delay", "float64", "(pixel,) in bins"),
        Buffer("deviation", "float64", "(pixel,) in bins"),
        Buffer("window_sums", "float64", "(pixel, band)"),
        Buffer("background", "float64", "(pixel,) counts per code"),
    ),
)
INTERFACE = Interface(
    "fit",
    (
        Constant("MOST_BANDS", MOST_BANDS, "bands that there is room for"),
        Constant("BLOCK_BINS", BLOCK_BINS, "bins of a block"),
        Constant("MOST_NODES", MOST_NODES, "delays of the posterior that there is room for"),
        Constant("RATIOS", RATIOS, "ratios of peak to background that the search tries"),
        Constant("BACKGROUND_SHARES", BACKGROUND_SHARES, "shares of background that it tries"),
        Constant("REFERENCE_MULTIPLE", REFERENCE_MULTIPLE, "of bins of a change reference"),
        Constant("MOST_WEIGHT", MOST_WEIGHT, "of a bin of a change reference"),
        Constant("LUCK_CELLS", LUCK_CELLS, "of heights above a limit"),
        Constant("LEAST_SHARE", LEAST_SHARE, "of a band's light in its zone"),
        Constant("LEAST_AMPLITUDE", LEAST_AMPLITUDE, "share of all counts"),
        Constant("CENTROID_ROUNDS", CENTROID_ROUNDS, "in which the window follows the centroid"),
        Constant("RESULT_PLANES", RESULT_PLANES, "numbers of a pixel besides its reflectances"),
        Constant("INFORMATION_COLUMNS", INFORMATION_COLUMNS, "of the table of information"),
        Constant("WINDOW", WINDOW, "rows and columns of the window about a pixel"),
    ),
    (
        TABLE_SIZES,
        FIT_RULES,
        CORRELATION_SIZES,
        INFORMATION_SCALE,
        PICTURE_RULES,
        PICTURE_SIZE,
    ),
    (
        FIT,
        CHANGE_REFERENCE,
        CHANGES,
        SUMS,
        CORRELATIONS,
        VERDICTS,
        PICTURE,
        SURFACE_STARTS,
    ),
)
