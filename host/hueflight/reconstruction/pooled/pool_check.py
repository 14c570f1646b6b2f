# SPDX-License-Identifier: Apache-2.0
"""Pools against the photons close by: what a pool smoothed over makes its depth less certain.

Three things are compared with the depth of a pool. The depths of the pools around it differ where
there is an edge or a thin structure, over which pools reach: their scatter adds to the variance.
The photons of small squares pull at the depth: where they do so more than chance explains, it
follows them. The photons of the pixel itself may show another depth so clearly that they refute
the pool; then the pixel gets the depth of its own photons, and a flag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.tables import detection_threshold
from hueflight.reconstruction.pooled.adaptive_weights import (
    STEP_PER_FWHM,
    TINY,
    Pools,
    box,
    scored,
)
from hueflight.reconstruction.pooled.kernels import Floats, Photons
from hueflight.reconstruction.pooled.tables import Tables

REACHES = (1, 0)  #: of the squares whose photons pull at the depth, in turn
AROUND = 4  #: reach of the squares over which the pull is averaged
CAUTION = 2.0  #: standard deviations of the mean pull that chance may cause
SCATTER_REACH = 2  #: of the squares over which pools scatter
SMOOTHED = 2.0  #: true variance of delays per variance of pools, which share photons
LEAST_SCATTER = 0.5  #: of a pool's variance: scatter below it is that of the photons
REFUTED = 16.0  #: of twice the log-likelihood ratio, for a range as wide as the shortest pulse


@dataclass(frozen=True, eq=False)
class OwnPhotons:
    """What the photons of each pixel say of its delay, without its neighbors.

    Attributes
    ----------
    likelihood : ndarray of float32, shape (row, col, lag)
        Log-likelihood ratio of a white train at some delay against background alone.
    lags_ns : ndarray of float, shape (lag,)
        Evenly spaced delays.
    """

    likelihood: Floats
    lags_ns: NDArray[np.float64]


def pulled(
    seen: Photons,
    pools: Pools,
    usable: NDArray[np.bool_],
    shown: NDArray[np.bool_],
    tables: Tables,
    search_ns: tuple[float, float],
    threads: int,
) -> tuple[Pools, Floats]:
    """Move depths to where the photons close by pull them, and say how far off they may be.

    The pull of a square has the variance of its information if the depth is right. What the mean of
    squares around exceeds it by is the variance of the depth's own error; the depth moves by the
    share that it has in the whole (empirical Bayes). Pools around that scatter suggest an error as
    well, which the depth does not follow, because squares reach over edges, too.

    Parameters
    ----------
    seen : Photons
        Photons of all pixels.
    pools : Pools
        What the neighborhoods hold.
    usable : ndarray of bool, shape (row, col)
        Pixels that are neither dead nor hot.
    shown : ndarray of bool, shape (row, col)
        Pixels at which there is a surface.
    tables : Tables
        Waveforms of the instrument.
    search_ns : tuple of float
        Least and greatest delay.
    threads : int
        Threads that share the planes.

    Returns
    -------
    pools : Pools
        The pools with other delays and variances.
    doubt : ndarray of float32, shape (row, col)
        Variance to add for what pools around and photons close by show, ns².
    """
    score, information = scored(seen, pools.delays_ns, pools.windows, tables)
    score, information = score * usable, information * usable
    scatter = _scatter(pools, shown, threads)
    delays_ns, variances = pools.delays_ns, pools.variances
    most_ns = STEP_PER_FWHM * tables.fwhm_ns
    # a delay that was cut off at the end of the search stays there
    inside = (delays_ns > search_ns[0]) & (delays_ns < search_ns[1])
    doubt = np.zeros_like(scatter)
    for reach in REACHES:
        near, known = box(np.stack([score, information]), reach, threads)
        known = np.maximum(known, TINY)
        excess, squares = box(np.stack([near**2 - known, known**2]), AROUND, threads)
        squares = np.maximum(squares, TINY)
        side, along = 2 * reach + 1, np.arange(-2 * reach, 2 * reach + 1)
        shared = ((1 - np.abs(along) / side) ** 2).sum() ** 2  # squares that overlap go together
        chance = np.sqrt(2 * shared / squares)
        error = np.maximum(excess / squares - CAUTION * chance - variances, 0)
        whole = variances + error
        share = np.where((error > 0) & inside, whole / (whole * known + 1), 0)
        step = np.clip(share * near, -most_ns, most_ns)
        delays_ns = delays_ns + step
        variances = np.maximum(variances, share)
        score = score - information * step
        if reach == REACHES[0]:
            left = scatter / (scatter * known + 1)
            doubt = left + np.minimum((left * (near - known * step)) ** 2, scatter)
    moved = replace(
        pools,
        delays_ns=np.clip(delays_ns, *search_ns).astype(np.float32),
        variances=variances.astype(np.float32),
    )
    return moved, doubt


def _scatter(pools: Pools, shown: NDArray[np.bool_], threads: int) -> Floats:
    """Variance (row, col) of delays of the pools around, where it is above that of photons, ns²."""
    ones = shown.astype(np.float32)
    delays_ns = (pools.delays_ns - pools.delays_ns.mean()) * ones
    count, first, second = box(np.stack([ones, delays_ns, delays_ns**2]), SCATTER_REACH, threads)
    count = np.maximum(count, 1)
    scatter = second / count - (first / count) ** 2
    return np.where(scatter > LEAST_SCATTER * pools.variances, SMOOTHED * scatter, 0)


def refuted(
    pools: Pools, own: OwnPhotons, tables: Tables, search_ns: tuple[float, float]
) -> tuple[Pools, NDArray[np.bool_]]:
    """Give pixels whose own photons refute the pool the depth that these show.

    Parameters
    ----------
    pools : Pools
        What the neighborhoods hold.
    own : OwnPhotons
        Likelihood of each pixel's own photons.
    tables : Tables
        Waveforms of the instrument.
    search_ns : tuple of float
        Least and greatest delay.

    Returns
    -------
    pools : Pools
        The pools with other delays and variances where refuted.
    refuted : ndarray of bool, shape (row, col)
        True where the photons of the pixel show a surface, and not at the depth of the pool.
    """
    spacing_ns = own.lags_ns[1] - own.lags_ns[0]
    shape, count = pools.delays_ns.shape, own.lags_ns.size
    flat = own.likelihood.reshape(-1, count)
    best = flat.argmax(axis=-1)
    highest = flat[np.arange(len(flat)), best]
    least = detection_threshold(search_ns)
    chosen = np.flatnonzero(2 * highest >= least)  # few: others can't refute anything
    far = np.zeros(shape, bool)
    if count < 3 or not chosen.size:
        return pools, far
    place = (pools.delays_ns.ravel()[chosen] - own.lags_ns[0]) / spacing_ns
    there, _, _ = _parabola(flat[chosen], np.clip(np.rint(place), 1, count - 2), place)
    middle = np.clip(best[chosen], 1, count - 2)
    top, shift, bend = _parabola(flat[chosen], middle, None)
    tries = max((search_ns[1] - search_ns[0]) / tables.fwhm_ns, 1.0)
    clear = 2 * (top - there) >= REFUTED + 2 * log(tries)
    clear &= np.abs(middle + shift - place) * spacing_ns > STEP_PER_FWHM * tables.fwhm_ns
    clear &= bend < 0
    chosen, delays_ns, variances = chosen[clear], pools.delays_ns.copy(), pools.variances.copy()
    moved = own.lags_ns[0] + (middle + shift)[clear] * spacing_ns
    delays_ns.ravel()[chosen] = np.clip(moved, *search_ns)
    variances.ravel()[chosen] = spacing_ns**2 / -bend[clear]
    far.ravel()[chosen] = True
    return replace(pools, delays_ns=delays_ns, variances=variances), far


def _parabola(
    values: Floats, middle: NDArray[np.floating | np.integer], place: NDArray[np.floating] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Value at a place, or at the peak, its distance from the middle, and the second derivative."""
    index = middle.astype(np.intp)
    rows = np.arange(len(values))
    left, here, right = (values[rows, index + step].astype(np.float64) for step in (-1, 0, 1))
    slope, bend = (right - left) / 2, left - 2 * here + right
    if place is None:
        shift = np.divide(-slope, bend, out=np.zeros_like(bend), where=bend < 0)
    else:
        shift = np.asarray(place - index, np.float64)
    shift = np.clip(shift, -1, 1)
    return here + slope * shift + bend / 2 * shift**2, shift, bend
