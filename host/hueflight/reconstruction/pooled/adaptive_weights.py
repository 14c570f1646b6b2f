# SPDX-License-Identifier: Apache-2.0
"""Adaptive neighborhoods: they grow in rounds, and end where neighbors show something else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from hueflight.reconstruction.pooled.kernels import (
    Floats,
    Likeness,
    Limits,
    Photons,
    Pooled,
    in_parts,
    pool,
    scores,
    window_counts,
)
from hueflight.reconstruction.pooled.tables import Tables

RADII = (1.5, 3.0, 6.0, 14.0)  #: of the rounds by color and depth
LIMITS = Limits(color=10.0, depth_color=15.0, depth=12.0)
LAST_RADIUS = 20.0  #: of the round for the depth of pools that then still lack photons,
LAST_LIMITS = Limits(color=10.0, depth_color=20.0, depth=12.0)  #: where depths are known better
PRIOR_PIXELS = 0.15  #: so many pixels of the image's mean count in every pool
FLOOR = 0.01  #: of a pool's photons: least amplitude and background in the weights
TINY = np.float32(1e-12)  #: keeps pools without a photon from dividing by 0
STEP_PER_FWHM = 0.21  #: that scoring may move a delay by


@dataclass(frozen=True, eq=False)
class Pools:
    """What the neighborhoods of all pixels hold.

    Attributes
    ----------
    delays_ns, variances : ndarray of float32, shape (row, col)
        Delay and its variance, ns².
    windows : ndarray of float32, shape (window, row, col)
        Mean photons per pixel in the window of each band and of the background.
    pixels, depth_pixels : ndarray of float32, shape (row, col)
        Number of pixels that an equally weighted neighborhood would hold, for spectrum and depth.
    information : ndarray of float32, shape (row, col)
        Fisher information on the delay, per ns².
    """

    delays_ns: Floats
    variances: Floats
    windows: Floats
    pixels: Floats
    depth_pixels: Floats
    information: Floats


def grown(
    seen: Photons,
    pilot: Floats,
    usable: NDArray[np.bool_],
    tables: Tables,
    search_ns: tuple[float, float],
    enough: float,
    threads: int,
) -> Pools:
    """Grow the neighborhoods of all pixels until each holds enough photons.

    Parameters
    ----------
    seen : Photons
        Photons of all pixels.
    pilot : ndarray of float32, shape (row, col)
        First estimate of the delay, ns.
    usable : ndarray of bool, shape (row, col)
        Pixels that are neither dead nor hot.
    tables : Tables
        Waveforms of the instrument.
    search_ns : tuple of float
        Least and greatest delay.
    enough : float
        Photons with which a neighborhood is closed.
    threads : int
        Threads that share the rows.

    Returns
    -------
    Pools
        What the neighborhoods hold.
    """
    windows = windows_of(seen, pilot, tables)
    ones = usable.astype(np.float32)
    around = box(np.concatenate([windows, ones[None]]), 4, threads)
    score, information = scored(seen, pilot, around[:-1] / np.maximum(around[-1], 1), tables)
    data = np.concatenate([windows, np.stack([information, information * pilot + score, ones])])
    pools = first_pools(windows, pilot, box(information[None], 2, threads)[0], usable, threads)
    active = np.ones(pilot.shape, bool)
    for radius in RADII:
        if not active.any():
            break
        like = likeness(pools, windows, usable, tables)
        found = pool(data, len(windows), usable, active, like, radius, LIMITS, threads=threads)
        last = radius == RADII[-1]
        pools, active = _closed(pools, active, found, tables, search_ns, enough, last=last)
    lacking = usable & (pools.windows.sum(axis=0) * pools.pixels < enough)
    if lacking.any():
        pools = _looked_again(seen, pools, windows, usable, lacking, tables, search_ns, threads)
    return pools


def _looked_again(
    seen: Photons,
    pools: Pools,
    windows: Floats,
    usable: NDArray[np.bool_],
    lacking: NDArray[np.bool_],
    tables: Tables,
    search_ns: tuple[float, float],
    threads: int,
) -> Pools:
    """Return pools in which those that lack photons take their depth from a wider circle.

    Until now neighbors were compared by the delays of the pilot, which are blurred across depth
    steps; now all have the delays of their own pools.
    """
    score, information = scored(seen, pools.delays_ns, pools.windows, tables)
    moment = information * pools.delays_ns + score
    data = np.stack([information, moment, usable.astype(np.float32)])
    like = likeness(pools, windows, usable, tables)
    found = pool(data, 0, usable, lacking, like, LAST_RADIUS, LAST_LIMITS, threads=threads)
    delays_ns, variances, pixels, _ = _depth_of(found, pools.delays_ns, tables, search_ns)
    return replace(
        pools,
        delays_ns=np.where(lacking, delays_ns, pools.delays_ns).astype(np.float32),
        variances=np.where(lacking, variances, pools.variances),
        depth_pixels=np.where(lacking, pixels, pools.depth_pixels),
    )


def windows_of(seen: Photons, delays_ns: Floats, tables: Tables) -> Floats:
    """Count the photons of each pixel itself in the windows of the bands.

    Parameters
    ----------
    seen : Photons
        Photons of all pixels.
    delays_ns : ndarray of float32, shape (row, col)
        Delay of each pixel.
    tables : Tables
        Waveforms of the instrument.

    Returns
    -------
    ndarray of float32, shape (window, row, col)
        Photons.
    """
    count = tables.bands + 1
    found = window_counts(seen, delays_ns.ravel(), tables.windows, tables.cells_per_ns, count)
    return found.reshape(count, *delays_ns.shape)


def first_pools(
    windows: Floats,
    delays_ns: Floats,
    information: Floats,
    usable: NDArray[np.bool_],
    threads: int,
) -> Pools:
    """Return the pools to begin with: squares of three by three pixels.

    Parameters
    ----------
    windows : ndarray of float32, shape (window, row, col)
        Photons of the pixels themselves.
    delays_ns, information : ndarray of float32, shape (row, col)
        Delay and the Fisher information on it.
    usable : ndarray of bool, shape (row, col)
        Pixels that are neither dead nor hot.
    threads : int
        Threads that share the planes.

    Returns
    -------
    Pools
        The pools.
    """
    near = box(np.concatenate([windows, usable[None].astype(np.float32)]), 1, threads)
    return Pools(
        delays_ns=delays_ns,
        variances=np.full(delays_ns.shape, np.inf, np.float32),
        windows=near[:-1] / np.maximum(near[-1], 1),
        pixels=near[-1],
        depth_pixels=near[-1],
        information=information,
    )


def likeness(pools: Pools, windows: Floats, usable: NDArray[np.bool_], tables: Tables) -> Likeness:
    """Return what neighbors are compared by.

    The mean of the image counts a little in every pool, so that an empty pool is not certain.

    Parameters
    ----------
    pools : Pools
        Pools so far.
    windows : ndarray of float32, shape (window, row, col)
        Photons of the pixels themselves.
    usable : ndarray of bool, shape (row, col)
        Pixels that are neither dead nor hot.
    tables : Tables
        Waveforms of the instrument.

    Returns
    -------
    Likeness
        Spectra and depths so far.
    """
    mean = windows.sum(axis=(1, 2)) / max(int(usable.sum()), 1)
    prior = (tables.groups.T @ mean * PRIOR_PIXELS)[:, None, None]
    groups = np.einsum("sg,srp->grp", tables.groups, pools.windows)
    means = (groups * pools.pixels + prior) / (pools.pixels + np.float32(PRIOR_PIXELS))
    return Likeness(means, pools.delays_ns, pools.pixels, pools.information)


def unmixed_of(windows: Floats, unmixing: Floats) -> Floats:
    """Convert photons in windows to amplitudes of the bands.

    This is no matrix product on purpose: the threads of the linear algebra library would wait for
    one another longer than such a small product takes.

    Parameters
    ----------
    windows : ndarray of float32, shape (window, row, col)
        Photons.
    unmixing : ndarray of float32, shape (band + 1, window)
        Inverse of the mixing of bands in windows.

    Returns
    -------
    ndarray of float32, shape (band + 1, row, col)
        Amplitudes, the background last.
    """
    return np.einsum("as,srp->arp", unmixing, windows)


def scored(
    seen: Photons, delays_ns: Floats, spectrum: Floats, tables: Tables
) -> tuple[Floats, Floats]:
    """Score and information (row, col) of the delays, given photons in windows around a pixel."""
    total = spectrum.sum(axis=0)
    unmixed = unmixed_of(spectrum, tables.unmixing)
    unmixed = np.maximum(unmixed, FLOOR * total + np.float32(1e-9))
    amplitudes = np.moveaxis(unmixed[:-1], 0, -1).reshape(-1, tables.bands)
    floors = (unmixed[-1] / np.float32(tables.period_ns)).ravel()
    score, information = scores(
        seen,
        delays_ns.ravel(),
        tables.shares,
        tables.slopes,
        tables.cells_per_ns,
        amplitudes,
        floors,
    )
    return score.reshape(delays_ns.shape), information.reshape(delays_ns.shape)


def _closed(
    pools: Pools,
    active: NDArray[np.bool_],
    found: Pooled,
    tables: Tables,
    search_ns: tuple[float, float],
    enough: float,
    *,
    last: bool,
) -> tuple[Pools, NDArray[np.bool_]]:
    """Pools after a round, and which of them go on; those that close take their delay."""
    weight = np.maximum(found.weight, TINY)
    pixels = found.weight**2 / np.maximum(found.squares, TINY)
    mean = found.sums[:-3] / weight
    closing = active & (last | (mean.sum(axis=0) * pixels >= enough))
    moved, variances, depth_pixels, information = _depth_of(
        found, pools.delays_ns, tables, search_ns
    )
    after = Pools(
        delays_ns=np.where(closing, moved, pools.delays_ns).astype(np.float32),
        variances=np.where(closing, variances, pools.variances),
        windows=np.where(active, mean, pools.windows),
        pixels=np.where(active, pixels, pools.pixels),
        depth_pixels=np.where(active, depth_pixels, pools.depth_pixels),
        information=np.where(active, information, pools.information),
    )
    return after, active & ~closing


def _depth_of(
    found: Pooled, delays_ns: Floats, tables: Tables, search_ns: tuple[float, float]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Delay (row, col) after a step from a delay, variance, pixels and information behind it."""
    information, moment, level = found.sums[-3:]
    level = np.maximum(level, TINY)
    pixels = level**2 / np.maximum(found.depth_squares, TINY)
    step = moment / np.maximum(information, TINY) - delays_ns
    most_ns = STEP_PER_FWHM * tables.fwhm_ns
    moved = delays_ns + np.clip(step, -most_ns, most_ns)
    # Σ w² I / (Σ w I)², for neighbors that tell about as much
    variances = found.depth_squares / level / np.maximum(information, TINY)
    return np.clip(moved, *search_ns), variances, pixels, information / level * pixels


def box(values: Floats, reach: int, threads: int) -> Floats:
    """Sums (plane, row, col) over squares."""
    side = 2 * reach + 1

    def some(stretch: tuple[int, int]) -> Floats:
        return uniform_filter(values[slice(*stretch)], (0, side, side), mode="constant")

    return np.concatenate(in_parts(some, len(values), threads, threads)) * np.float32(side**2)
