# SPDX-License-Identifier: Apache-2.0
"""Interface of the kernel behind the pooled method."""

from hueflight.backend.interface import ANY, Buffer, Constant, Field, Function, Interface, Record

MOST_PLANES = 40  #: planes of data that have room in the registers
MOST_GROUPS = 8  #: groups of bands by which neighbors are compared
LANES = 16  #: pixels side by side

PHOTONS = (
    Buffer("starts", "int64", "(pixel + 1,) first entry of each pixel"),
    Buffer("times", "float32", "(entry,) within the period, ns"),
    Buffer("weights", "float32", "(entry,) photons that share the time"),
)

GRID = Record("Grid", "Scale of tables over the period.", (Field("cells_per_ns", "float32"),))
PERIOD = Record("Period", "Time after which pulses repeat.", (Field("period_ns", "float32"),))
SQUARES_SIZE = Record(
    "SquaresSize",
    "Shape of the image that squares lie in.",
    (Field("rows", "int32"), Field("cols", "int32")),
)
POOL_SIZES = Record(
    "PoolSizes",
    "What a call of pool works on.",
    (
        Field("first_row", "int32"),
        Field("end_row", "int32", "one past the last"),
        Field("rows", "int32"),
        Field("cols", "int32"),
        Field("rim", "int32", "padding around the image, pixels"),
        Field("groups", "int32", "of bands by which neighbors are compared"),
        Field("planes", "int32", "that are summed"),
        Field("spectral", "int32", "planes that are summed with the weights of spectra"),
    ),
)
POOL_LIMITS = Record(
    "PoolLimits",
    "Inverse of the log-likelihood ratios at which a neighbor counts no longer.",
    (
        Field("color", "float32", "of the spectrum"),
        Field("depth_color", "float32", "of the spectrum, for the weights of depth"),
        Field("depth", "float32", "of the depth"),
    ),
)

LIST = Function(
    "list",
    "photons of histograms; starts tells how many there are even if they do not fit",
    (
        Buffer("counts", ANY, "(pixel, code) uint16, uint32 or float32"),
        Buffer("code_times", "float32", "(code,) below 0 for codes that are no photon"),
        Buffer("pixel_delays", "float32", "(pixel,)"),
        Buffer("period", PERIOD),
    ),
    PHOTONS,
)
LAGS = Function(
    "lags",
    "log-likelihood of delays",
    (
        *PHOTONS,
        Buffer("table", "float32", "(cell,) log-likelihood of a photon"),
        Buffer("grid", GRID),
        Buffer("lags", "int32", "(lag,) in cells"),
    ),
    (Buffer("result", "float32", "(pixel, lag)"),),
)
WINDOWS = Function(
    "windows",
    "photons in the window of each band at a delay",
    (
        *PHOTONS,
        Buffer("delays", "float32", "(pixel,)"),
        Buffer("owners", "int8", "(cell,) window that a cell belongs to"),
        Buffer("grid", GRID),
    ),
    (Buffer("result", "float32", "(window, pixel)"),),
)
SQUARES = Function(
    "squares",
    "photons in the window of each band at a delay, over squares of pixels",
    (
        *PHOTONS,
        Buffer("size", SQUARES_SIZE),
        Buffer("pixels", "int64", "(square,) middle of each square"),
        Buffer("reach", "int32", "(square,) pixels to either side"),
        Buffer("delays", "float32", "(square,)"),
        Buffer("owners", "int8", "(cell,) window that a cell belongs to"),
        Buffer("grid", GRID),
    ),
    (Buffer("result", "float32", "(square, window)"),),
)
SCORES = Function(
    "scores",
    "score and information of delays",
    (
        *PHOTONS,
        Buffer("delays", "float32", "(pixel,)"),
        Buffer("shares", "float32", "(cell, band) per ns"),
        Buffer("slopes", "float32", "(cell, band) derivative of shares by time"),
        Buffer("amplitudes", "float32", "(pixel, band) photons"),
        Buffer("floors", "float32", "(pixel,) background per ns"),
        Buffer("grid", GRID),
    ),
    (Buffer("score", "float32", "(pixel,)"), Buffer("information", "float32", "(pixel,) per ns^2")),
)
POOL = Function(
    "pool",
    "weighted sums over neighbors",
    (
        Buffer("sizes", POOL_SIZES),
        Buffer("limits", POOL_LIMITS),
        Buffer("steps", "int32", "(neighbor, 2) rows and columns from the pixel"),
        Buffer("kernel", "float32", "(neighbor,) weight by distance"),
        Buffer("roots", "float32", "(group, row, col) padded: square roots of pooled counts"),
        Buffer("delays", "float32", "(row, col) padded"),
        Buffer("valid", "float32", "(row, col) padded: 1 or 0"),
        Buffer("data", "float32", "(plane, row, col) padded"),
        Buffer("trust", "float32", "(row, col) twice the pixels pooled so far"),
        Buffer("information", "float32", "(row, col) half the information on the delay so far"),
        Buffer("active", "uint8", "(row, col) pixels that are asked for"),
    ),
    (Buffer("result", "float32", "(plane + 3, row, col): sums, weights, squares, depth squares"),),
)

INTERFACE = Interface(
    "pooled",
    (
        Constant("MOST_PLANES", MOST_PLANES, "planes of data that have room in the registers"),
        Constant("MOST_GROUPS", MOST_GROUPS, "groups of bands by which neighbors are compared"),
        Constant("LANES", LANES, "pixels side by side"),
    ),
    (GRID, PERIOD, SQUARES_SIZE, POOL_SIZES, POOL_LIMITS),
    (LIST, LAGS, WINDOWS, SQUARES, SCORES, POOL),
)
