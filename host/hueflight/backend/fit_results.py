# SPDX-License-Identifier: Apache-2.0
"""Interface of what follows the compiled fit: results, and surfaces about pixels."""

from hueflight.backend.interface import Buffer, Field, Function, Record

LUCK_CELLS = 256  #: equal stretches of heights, of each of which the first limit is tabulated
WINDOW = 5  #: rows and columns of the window in which surfaces about a pixel are looked for
INFORMATION_COLUMNS = 4  #: numbers of each band and ratio in the table of information
RESULT_PLANES = 8  #: numbers of a pixel of a picture besides its reflectances

INFORMATION_SCALE = Record(
    "InformationScale",
    "Ratios of a band's photons to background at which tables are given.",
    (
        Field("points", "int32", "of the tables"),
        Field("least", "float32", "ratio"),
        Field("first_log", "float32", "its natural logarithm"),
        Field("per_log", "float32", "points per unit of the logarithm"),
    ),
)
PICTURE_RULES = Record(
    "PictureRules",
    "Constants of hueflight/reconstruction/conversion.py, and what all pixels of a picture share.",
    (
        Field("distance", "float64", "of the reference, m"),
        Field("blind_ns", "float64", "deviation of who knows nothing"),
        Field("least_detection", "float64", "ratio from which there is a surface"),
        Field("low_ns", "float64", "delay up to which it was cut off"),
        Field("high_ns", "float64", "delay from which it was"),
        Field("misfit_limit", "float64", "score that is flagged"),
        Field("plain_misfit", "float64", "chi-square that is counted as great"),
        Field("misfit", "float64", "factor of the variance of photon noise"),
        Field("brightness", "float64", "of all bands together"),
        Field("background_scale", "float64", "from all bins to one code"),
        Field("periods", "float64", "of an exposure"),
        Field("fewest_exposures", "float64", "fewer are none"),
        Field("most_closed", "float64", "share of exposures that may hold a photon"),
        Field("least_empty", "float64", "share of exposures that must be empty"),
        Field("least_bias", "float64", "share of the information that makes no difference"),
        Field("most_bias", "float64", "share that is taken back at most"),
        Field("cells_per_height", "float64", "of luck_cells"),
        Field("first_tail", "float64", "score of the first tail"),
        Field("tail_step", "float64", "between scores"),
        Field("last_tail", "float64", "score from which the probability is 0"),
        Field("pixels", "int32", "of the picture"),
        Field("counted", "int32", "the exposures are those of the counts"),
        Field("scaled", "int32", "light is that of one exposure"),
        Field("pileup_correction", "int32"),
        Field("range_correction", "int32"),
        Field("low_signal", "int32", "flags of quality"),
        Field("saturated", "int32"),
        Field("ambiguous", "int32"),
        Field("no_return", "int32"),
        Field("out_of_range", "int32"),
        Field("misfit_flag", "int32"),
        Field("piled_up", "int32"),
    ),
)
_DELAYS = (
    Buffer("delay_ns", "float64", "(fit,)"),
    Buffer("delay_std_ns", "float64", "(fit,)"),
    Buffer("other_ns", "float64", "(fit,) second delay or NaN"),
    Buffer("detection", "float64", "(fit,) twice a log-likelihood ratio, or NaN"),
    Buffer("chi_square", "float64", "(fit,) per degree of freedom, or NaN"),
    Buffer("misfit", "float64", "(fit,) greatest score, or NaN"),
)
VERDICTS = Function(
    "verdicts",
    "flags of fits, see hueflight/reconstruction/conversion.py",
    (
        Buffer("rules", PICTURE_RULES),
        *_DELAYS,
        Buffer("meters_per_ns", "float64", "(fit,) depth per delay"),
    ),
    (
        Buffer("flags", "uint16", "(fit,)"),
        Buffer("tally", "int64", "(3,) told chi-squares, those above 1, those that are great"),
    ),
)
PICTURE = Function(
    "picture",
    "results of pixels at their places in a picture, see hueflight/reconstruction/conversion.py",
    (
        Buffer("rules", PICTURE_RULES),
        *_DELAYS,
        Buffer("flags", "uint16", "(fit,) of verdicts"),
        Buffer("amplitudes", "float64", "(fit, band) photons"),
        Buffer("amplitude_std", "float64", "(fit, band)"),
        Buffer("background", "float64", "(fit,) photons"),
        Buffer("places", "int64", "(pixel,) in the picture"),
        Buffer("fits", "int64", "(pixel,) number of its fit, rising by 1, or -1"),
        Buffer("photons", "float64", "(place,)"),
        Buffer("exposures", "float64", "(place,) if light is scaled or exposures are counted"),
        Buffer("base", "uint16", "(place,) flags of the calibration"),
        Buffer("meters_per_ns", "float64", "(place,) depth per delay"),
        Buffer("delay_variance", "float64", "(place,) of the calibration, ns2"),
        Buffer("brightness_variance", "float64", "(place,) relative"),
        Buffer("flat_field", "float64", "(place,)"),
        Buffer("reference_loss", "float64", "(place,) without pile-up correction: of photons"),
        Buffer("inverse", "float64", "(band,) 1 / brightness"),
        Buffer("uncertainty", "float64", "(band,) relative variance of the brightness"),
        Buffer("scale", INFORMATION_SCALE),
        Buffer(
            "table",
            "float32",
            "(ratio, band, column) information on the delay, its step to the "
            "next ratio, half its second derivative, its step",
        ),
        Buffer("placement", "float32", "(band,) variance of a waveform's place in time"),
        Buffer("luck", "float64", "(2, point) rising heights above a limit, and the limits"),
        Buffer("luck_cells", "int32", "(cell,) last limit at or before it"),
        Buffer("tails", "float64", "(score,) logarithms of probabilities"),
    ),
    (
        Buffer("numbers", "float64", "(plane, place) in the order of result_planes.py"),
        Buffer("reflectances", "float32", "(2, place, band) values and deviations"),
        Buffer("quality", "uint16", "(place,)"),
    ),
)
PICTURE_SIZE = Record(
    "PictureSize",
    "Shape of a picture, and how far apart the pixels of a surface are.",
    (
        Field("rows", "int32"),
        Field("cols", "int32"),
        Field("reach", "float32", "standard deviations"),
    ),
)
SURFACE_STARTS = Function(
    "surface_starts",
    "where surfaces about a pixel are looked for, see hueflight/reconstruction/edges.py",
    (
        Buffer("depth", "float32", "(row, col) or NaN"),
        Buffer("deviation", "float32", "(row, col)"),
        Buffer("size", PICTURE_SIZE),
    ),
    (
        Buffer("near", "float32", "(row, col) of pixels with a whole window"),
        Buffer("far", "float32", "the same"),
    ),
)
