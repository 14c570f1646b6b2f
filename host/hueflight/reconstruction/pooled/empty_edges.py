# SPDX-License-Identifier: Apache-2.0
"""Where empty regions end: pixels beside them, judged by their own photons and their neighbors.

Squares and pools that tell whether there is a surface reach over the edge of an empty region. The
photons of one pixel often do not tell on which side of the edge it lies, but those of its
neighbors, most of which are on the same side, do. Each pixel near an edge has two states, *surface*
and *empty*; its own photons speak for one of them by the ratio of likelihoods, and each of the
eight neighbors for its own state (an Ising model, solved by mean fields: Zhang, IEEE Trans. Signal
Process. 40, 2570, 1992).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, distance_transform_edt

from hueflight.fit.detection import BACKGROUND_SHARE
from hueflight.reconstruction.pooled.adaptive_weights import TINY, Pools, unmixed_of
from hueflight.reconstruction.pooled.kernels import Photons
from hueflight.reconstruction.pooled.tables import Tables

REACH = 3.0  #: pixels from an edge within which states are decided
SURE = 1.5  #: pixels from an edge beyond which a pool shows the surface alone
NEAR = 6.0  #: pixels within which such a pool tells what the surface would look like
#: twice what a neighbor adds to the log-odds; diagonal ones are farther away
COUPLING = np.array([[0.7, 1.0, 0.7], [1.0, 0.0, 1.0], [0.7, 1.0, 0.7]])
ROUNDS = 20  #: of the mean fields, which then move no more
KEPT = 0.8  #: probability with which a surface stays one
FOUND = 0.95  #: probability with which an empty pixel becomes a surface


def settled(
    seen: Photons,
    pools: Pools,
    absent: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    tables: Tables,
) -> NDArray[np.bool_]:
    """Decide near the edges of empty regions which pixels belong to them.

    Nothing is decided without a surface nearby that is wide enough to be seen alone.

    Parameters
    ----------
    seen : Photons
        Photons of all pixels.
    pools : Pools
        What the neighborhoods hold.
    absent : ndarray of bool, shape (row, col)
        Pixels without a surface, so far.
    usable : ndarray of bool, shape (row, col)
        Pixels that are neither dead nor hot.
    tables : Tables
        Waveforms of the instrument.

    Returns
    -------
    ndarray of bool, shape (row, col)
        Pixels without a surface.
    """
    from_empty = distance_transform_edt(~absent) if absent.any() else None
    if from_empty is None or not (sure := (from_empty > SURE) & usable).any():
        return absent
    from_sure, nearest = distance_transform_edt(~sure, return_indices=True)
    from_surface = distance_transform_edt(absent)
    near = (from_empty + from_surface <= REACH) & (from_sure <= NEAR) & usable
    if not near.any():
        return absent
    there = nearest[0, near] * absent.shape[1] + nearest[1, near]
    here = np.flatnonzero(near)
    speaks = _log_odds(seen, here, pools, there, tables)
    shown = ~absent.ravel()[here]
    speaks[shown] = np.maximum(
        speaks[shown], _log_odds(seen, here[shown], pools, here[shown], tables)
    )
    probability = _probability(absent, near, speaks)
    empty = absent.copy()
    empty[near] = probability < np.where(shown, KEPT, FOUND)
    return empty


def _log_odds(
    seen: Photons,
    pixels: NDArray[np.intp],
    pools: Pools,
    pool_of: NDArray[np.intp],
    tables: Tables,
) -> NDArray[np.float64]:
    """Log-likelihood ratio (pixel,) of the photons of pixels, of a pool against background alone.

    Only arrival times count: dark counts differ from pixel to pixel, so that their number tells
    less.
    """
    windows = pools.windows.reshape(len(pools.windows), -1)[:, pool_of]
    delays_ns = pools.delays_ns.ravel()[pool_of]
    amounts = np.maximum(unmixed_of(windows[..., None], tables.unmixing)[..., 0], 0)
    amounts[-1] = np.maximum(amounts[-1], BACKGROUND_SHARE * windows.sum(axis=0))
    amounts /= np.maximum(amounts.sum(axis=0), TINY)
    starts, lengths = seen.starts[pixels], np.diff(seen.starts)[pixels]
    owner = np.repeat(np.arange(pixels.size), lengths)
    entry = np.arange(owner.size) + np.repeat(starts - (np.cumsum(lengths) - lengths), lengths)
    place = (seen.times_ns[entry] - delays_ns[owner]) * np.float32(tables.cells_per_ns)
    cell = np.floor(place).astype(np.intp) % len(tables.shares)
    rate = amounts[-1][owner]
    for band in range(tables.bands):
        rate = rate + amounts[band][owner] * tables.shares[cell, band] * tables.period_ns
    gain = seen.weights[entry] * np.log(np.maximum(rate, TINY))
    return np.bincount(owner, gain, pixels.size).astype(np.float64)


def _probability(
    absent: NDArray[np.bool_], near: NDArray[np.bool_], speaks: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Probability (pixel,) of a surface in pixels near an edge; the others keep their state."""
    state = np.where(absent, -1.0, 1.0)
    for _ in range(ROUNDS):
        field = convolve(state, COUPLING, mode="nearest")[near]
        state[near] += np.tanh((speaks + field) / 2)
        state[near] /= 2
    return (1 + state[near]) / 2
