# SPDX-License-Identifier: Apache-2.0
"""The compiled kernel of the published method: its arguments are prepared once per calibration."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit import CORRELATION_SIZES, CORRELATIONS
from hueflight.calibration import Calibration
from hueflight.fit.solver import COUNT_TYPES, compiled_kernel

TILE_PIXELS = 1024  #: pixels made ready at once

_ready: WeakKeyDictionary[Calibration, Ready | None] = WeakKeyDictionary()


@dataclass(frozen=True)
class Search:
    """Lags of the correlation in bins.

    Attributes
    ----------
    search : int
        Largest lag that is searched.
    half_width : float
        Half the window of the centroid.
    most : int
        Largest lag that the window reaches.
    """

    search: int
    half_width: float
    most: int


@dataclass(frozen=True)
class Measured:
    """Measurements of pixels.

    Attributes
    ----------
    delay, deviation : ndarray of float, shape (pixel,)
        Delay and its standard deviation, bins.
    sums : ndarray of float, shape (pixel, band)
        Counts in the shifted windows of each band.
    background : ndarray of float, shape (pixel,)
        Counts per code outside the windows.
    """

    delay: NDArray[np.float64]
    deviation: NDArray[np.float64]
    sums: NDArray[np.float64]
    background: NDArray[np.float64]


@dataclass(frozen=True)
class Ready:
    """A calibration as the kernel reads it; fields are arguments of `CORRELATIONS`.

    Attributes
    ----------
    sizes : ndarray of void, shape (1,)
        A `CorrelationSizes` record.
    windows : ndarray of int32, shape (window, 3)
        Band, first bin, one past the last.
    gaps : ndarray of int32, shape (gap, 2)
        First bin and one past the last of bins in no window.
    reference : ndarray of uint16, shape (pixel, bin)
        Whole counts, continued around the circle on both sides by as many bins as there are lags.
    pixel_delays : ndarray of float, shape (pixel,)
        Delays of the pixels themselves, bins.
    """

    sizes: NDArray[np.void]
    windows: NDArray[np.int32]
    gaps: NDArray[np.int32]
    reference: NDArray[np.uint16]
    pixel_delays: NDArray[np.float64]


def measure(
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    photons: float,
    calibration: Calibration,
    search: Search,
    outside: NDArray[np.bool_],
) -> Measured | None:
    """Measure pixels by the compiled kernel.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order.
    pixels : ndarray of int64
        Pixels to measure.
    photons : float
        The most that a pixel holds.
    calibration : Calibration
        Calibration of the same instrument.
    search : Search
        Lags that are searched.
    outside : ndarray of bool, shape (bin,)
        Bins that belong to no window.

    Returns
    -------
    Measured or None
        Measurements; None where the kernel is not there or does not take these numbers.
    """
    kernel = compiled_kernel()
    if kernel is None or light.dtype not in COUNT_TYPES[:2]:
        return None
    if calibration not in _ready:
        _ready[calibration] = _made_ready(calibration, search, outside)
    ready = _ready[calibration]
    if ready is None or photons * (search.half_width + 2) >= 2**31:  # its sums are of 32 bits
        return None
    count, bands = len(pixels), len(calibration.instrument.bands)
    delay, deviation, background = (np.empty(count) for _ in range(3))
    sums = np.empty((count, bands))
    kernel.correlations(
        *CORRELATIONS.arguments(
            counts=light,
            pixels=np.ascontiguousarray(pixels, np.int64),
            **{field.name: getattr(ready, field.name) for field in fields(ready)},
            delay=delay,
            deviation=deviation,
            window_sums=sums,
            background=background,
        )
    )
    return Measured(delay, deviation, sums, background)


def _made_ready(
    calibration: Calibration, search: Search, outside: NDArray[np.bool_]
) -> Ready | None:
    """None if the reference does not consist of whole counts of 16 bits, or its sums overflow."""
    counts = calibration.reference.reshape(-1, calibration.bins.count)
    reach = round(search.half_width)
    highest = min(np.iinfo(np.uint16).max, 2**32 // (reach + 1) ** 2)  # its slopes are of 32 bits
    around = np.arange(-search.most, counts.shape[1] + search.most) % counts.shape[1]
    reference = np.empty((len(counts), around.size), np.uint16)
    for start in range(0, len(counts), TILE_PIXELS):
        tile = counts[start : start + TILE_PIXELS]
        if not ((tile >= 0) & (tile <= highest)).all():
            return None
        whole = tile.astype(np.uint16)
        if (whole != tile).any():
            return None
        reference[start : start + TILE_PIXELS] = whole[:, around]
    steps = np.diff(np.concatenate([[0], outside.astype(np.int8), [0]]))
    gaps = np.stack([np.flatnonzero(steps > 0), np.flatnonzero(steps < 0)], axis=-1)
    circular = calibration.bins.period_ns is not None
    bands = len(calibration.instrument.bands)
    windows = [(window.band, window.start, window.stop) for window in calibration.windows]
    return Ready(
        sizes=CORRELATION_SIZES.pack(
            half_width=search.half_width,
            search=search.search,
            reach=reach,
            most=search.most,
            highest=reference.max(initial=0),
            circular=circular,
            bands=bands,
            outside=outside.sum(),
        ),
        windows=np.array(windows, np.int32).reshape(-1, 3),
        gaps=gaps.astype(np.int32),
        reference=reference,
        pixel_delays=np.ascontiguousarray(calibration.pixel_delay.ravel(), np.float64),
    )
