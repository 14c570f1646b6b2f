# SPDX-License-Identifier: Apache-2.0
"""Systematic error of the published delay: the centroid of a linear correlation without noise.

A linear correlation has fewer products at larger lags, so that light between the pulses (background
or tails that overlap) draws the centroid to lag 0; bins and the edges of the window draw it to
whole bins. Both are found by running the method on expected counts: the waveforms of the
calibration at known delays, over several levels of background. The bands are as bright as in the
reference; what strongly coloured surfaces add where pulses overlap is not included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration, window_sums
from hueflight.fit.correlation import correlate, peak_centroid
from hueflight.reconstruction.paper_kernel import Search

DELAYS = 192  #: delays that are tried over the range searched, at most
PHASES = 4  #: delays that are tried within a bin
#: background of a pixel beyond that of the reference, relative to the mean of the reference
LEVELS = np.array([0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])
SAMPLED_PIXELS = 512  #: pixels whose mean stands for the reference
TILE_PIXELS = 1024  #: pixels whose contrast is computed at once
BRIGHT = 1e12  #: photons of counts without noise

_tables: WeakKeyDictionary[Calibration, BiasTable] = WeakKeyDictionary()


@dataclass(frozen=True)
class BiasTable:
    """Largest systematic error by share of background and by the delay that is found.

    Attributes
    ----------
    found : ndarray of float, shape (cell,)
        Middles of the cells of found delays, bins.
    share : ndarray of float, shape (level,)
        Apparent share of background in the photons of each level, ascending.
    error : ndarray of float, shape (level, cell)
        Largest magnitude of found minus true delay in each cell, bins.
    """

    found: NDArray[np.float64]
    share: NDArray[np.float64]
    error: NDArray[np.float64]


def correlation_bias(
    delay: NDArray[np.float64],
    share: NDArray[np.float64],
    calibration: Calibration,
    search: Search,
) -> NDArray[np.float64]:
    """Return the systematic error of delays that the published method found.

    Parameters
    ----------
    delay : ndarray of float, shape (pixel,)
        Delays that were found, bins.
    share : ndarray of float, shape (pixel,)
        Share of background in the photons, as `background_share` gives it.
    calibration : Calibration
        Calibration of the same instrument.
    search : Search
        Lags that are searched.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Magnitude of the error in bins.
    """
    if calibration not in _tables:
        _tables[calibration] = _table(calibration, search)
    table = _tables[calibration]
    level = np.interp(share, table.share, np.arange(table.share.size))
    below = np.minimum(level.astype(np.intp), table.share.size - 2)
    step = table.found[1] - table.found[0]
    place = np.rint((delay - table.found[0]) / step)
    place = np.clip(place, 0, table.found.size - 1).astype(np.intp)
    low, high = table.error[below, place], table.error[below + 1, place]
    return low + (high - low) * (level - below)


def background_share(
    light: NDArray[Any],
    pixels: NDArray[np.intp],
    sums: NDArray[np.floating],
    photons: NDArray[np.floating],
    calibration: Calibration,
) -> NDArray[np.float64]:
    """Return which share of the photons of pixels seems to be background.

    Outside the windows that moved with the pixel's delay, everything counts as background. Where
    the windows leave no bins, the contrast of the counts tells it.

    Parameters
    ----------
    light : ndarray, shape (any, bin)
        Counts in time order.
    pixels : ndarray of int, shape (pixel,)
        Rows of `light` that are meant.
    sums : ndarray, shape (pixel, band)
        Counts in the moved windows.
    photons : ndarray, shape (pixel,)
        All counts.
    calibration : Calibration
        Calibration of the same instrument.

    Returns
    -------
    ndarray of float, shape (pixel,)
        The share; statistical noise may bring it beyond 0 and 1.
    """
    count = calibration.bins.count
    outside = count - sum(window.stop - window.start for window in calibration.windows)
    if outside > 0:
        return (photons - sums.sum(axis=-1)) / np.maximum(photons, 1) * count / outside
    contrast = np.empty(photons.shape)
    for start in range(0, pixels.size, TILE_PIXELS):
        here = slice(start, start + TILE_PIXELS)
        counts = light[pixels[here]].astype(np.float64)
        square = np.einsum("pb,pb->p", counts, counts)
        # the variance of Poisson noise is the number of photons
        spread = square - photons[here] ** 2 / count - photons[here] * (1 - 1 / count)
        contrast[here] = np.sqrt(np.maximum(spread, 0) * count)
    return 1 - contrast / np.maximum(photons, 1)


def _table(calibration: Calibration, search: Search) -> BiasTable:
    brightness, background = _mean_reference(calibration)
    (reference,) = _moved(calibration, brightness, background, np.zeros(1))
    true = np.linspace(-search.search, search.search, min(2 * search.search * PHASES, DELAYS) + 1)
    moved = _moved(calibration, brightness, background, true)
    mean = float(reference.mean())
    found_at = np.linspace(-search.search, search.search, min(4 * search.search, DELAYS) + 1)
    spacing = found_at[1] - found_at[0]
    levels = np.concatenate([[-background / mean], LEVELS])
    error = np.zeros((levels.size, found_at.size))
    share = np.zeros(levels.size)
    for number, level in enumerate(levels):
        light = moved + level * mean
        correlation = correlate(light, reference, search.most)
        found = peak_centroid(correlation, search=search.search, half_width=search.half_width)
        cell = np.rint((found - found_at[0]) / spacing).astype(np.intp)
        reached = np.full(found_at.size, -1.0)
        np.maximum.at(reached, cell, np.abs(found - true))
        known = reached >= 0
        error[number] = np.interp(found_at, found_at[known], reached[known])
        share[number] = _expected_share(reference + level * mean, calibration)
    return BiasTable(found=found_at, share=np.maximum.accumulate(share), error=error)


def _expected_share(expected: NDArray[np.float64], calibration: Calibration) -> float:
    """`background_share` of expected counts (bin,) that have no delay and no noise."""
    bands = len(calibration.instrument.bands)
    circular = calibration.bins.period_ns is not None
    still = np.zeros(1, np.intp)
    sums = window_sums(expected[None], calibration.windows, still, bands=bands, circular=circular)
    scale = BRIGHT / expected.sum()  # so bright that the noise, which is taken off, is none
    return float(
        background_share(
            scale * expected[None], still, scale * sums.T, np.array([BRIGHT]), calibration
        )[0]
    )


def _mean_reference(calibration: Calibration) -> tuple[float, float]:
    """Brightness of the mean pixel's reference, and its background per bin."""
    pixels = np.flatnonzero(calibration.usable)
    pixels = pixels[:: max(1, pixels.size // SAMPLED_PIXELS)]
    bins = calibration.bins
    counts = calibration.reference.reshape(-1, bins.count)[pixels].astype(np.float64)
    whole = np.rint(calibration.pixel_delay.ravel()[pixels]).astype(np.intp)
    index = (np.arange(bins.count) + whole[:, None]) % bins.count
    mean = np.take_along_axis(counts, index, axis=-1).mean(axis=0)
    shares = calibration.templates.shares(bins.edges_ns)
    flat = bins.widths_ns / bins.widths_ns.mean()
    # the background and the brightness of the whole train, with its bands as calibrated
    train = calibration.brightness @ shares
    parts = np.stack([train, flat])
    (brightness, background), *_ = np.linalg.lstsq(parts.T, mean, rcond=None)
    background = max(float(background), 0.0)
    return float(brightness), background


def _moved(
    calibration: Calibration,
    brightness: float,
    background: float,
    delays: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Expected counts (delay, bin) of the reference's light, later by delays in bins."""
    bins = calibration.bins
    step_ns = bins.span_ns / bins.count
    flat = background * bins.widths_ns / bins.widths_ns.mean()
    shares = calibration.templates.shares(bins.edges_ns, (delays * step_ns)[:, None])
    return brightness * np.einsum("k,kdb->db", calibration.brightness, shares) + flat
