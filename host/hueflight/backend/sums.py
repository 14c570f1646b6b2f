# SPDX-License-Identifier: Apache-2.0
"""Interface of the kernel that estimates from sums."""

from hueflight.backend.interface import Buffer, Constant, Field, Function, Interface, Record
from hueflight_protocol.reduction import MOST_SUMS

MOST_BANDS = 30  #: that there is room for
MOST_LAGS = 128  #: of the search that there is room for
LANES = 16  #: pixels side by side, and floats to which rows of tables are made up

SIZES = Record(
    "Sizes",
    "Sizes and scales of the tables, and constants of the estimator.",
    (
        Field("bands", "int32"),
        Field("sums", "int32"),
        Field("lags", "int32", "delays that the search looks at"),
        Field("lag_phases", "int32", "tabulated delays per lag"),
        Field("rest", "int32", "null directions of a lag"),
        Field("first_ns", "float32", "first tabulated delay"),
        Field("phase_ns", "float32", "between tabulated delays"),
        Field("floor_share", "float32", "least background in the weights, of all photons"),
        Field("floor_photons", "float32", "and in photons"),
        Field("ridge", "float32", "on the diagonal, relative to it"),
    ),
)

ESTIMATE = Function(
    "estimate",
    "delay, amplitudes and background of pixels from their sums; (...) rows are made up to LANES",
    (
        Buffer("sizes", SIZES),
        Buffer("sums", "float32", "(pixel, sum); the first is the number of photons"),
        Buffer("number", "int32", "(pixel,) place of its offset in the tables"),
        Buffer("whiten", "float32", "(sum, sum) matrix to whitened sums"),
        Buffer("dark_test", "float32", "(sum - 1, sum) matrix on whitened sums less background"),
        Buffer("separate", "float32", "(offset, phase, sum, (sum)) matrix to photons and rest"),
        Buffer("slopes", "float32", "(offset, phase, band, (sum)) of photons and rest, per ns"),
        Buffer("dark", "float32", "(offset, (sum))"),
        Buffer("covariances", "float32", "(phase, band + 1, (entry)) of photons and rest"),
        Buffer("nulls", "float32", "(lag, rest, sum)"),
    ),
    (
        Buffer("delay", "float64", "(pixel,) ns"),
        Buffer("delay_std", "float64", "(pixel,) its deviation, ns"),
        Buffer("amplitudes", "float64", "(pixel, band) photons"),
        Buffer("amplitude_std", "float64", "(pixel, band) their deviations"),
        Buffer("background", "float64", "(pixel,) photons"),
        Buffer("distance", "float64", "(pixel,) squared, from the fit"),
        Buffer("dark_distance", "float64", "(pixel,) squared, from background"),
    ),
)

INTERFACE = Interface(
    "sums",
    (
        Constant("MOST_SUMS", MOST_SUMS, "per pixel that there is room for"),
        Constant("MOST_BANDS", MOST_BANDS, "that there is room for"),
        Constant("MOST_LAGS", MOST_LAGS, "of the search that there is room for"),
        Constant("LANES", LANES, "pixels side by side, and floats to which rows are made up"),
    ),
    (SIZES,),
    (ESTIMATE,),
)
