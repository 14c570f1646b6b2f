# SPDX-License-Identifier: Apache-2.0
"""Whether a neighborhood shows a surface at all: likelihood ratio of pulses against background.

A pool consists of neighbors that were chosen because they look alike, and its photons were counted
at delays that were chosen because many photons lie there. Background alone therefore makes pools
that look like faint surfaces. Where a pool is not far above that, whole squares of pixels are
counted anew, all at the pool's one delay. Of them, as of a single pixel, one threshold holds for
all numbers of photons; see `hueflight.fit.detection`.
"""

from __future__ import annotations

from math import log

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.detection import BACKGROUND_SHARE
from hueflight.fit.tables import detection_threshold
from hueflight.reconstruction.pooled.adaptive_weights import TINY, Pools
from hueflight.reconstruction.pooled.kernels import Photons, in_parts, square_counts
from hueflight.reconstruction.pooled.tables import Tables

PLAIN = 200.0  #: ratio of pools that are certain: those of background alone stay below 160


def without_return(
    seen: Photons,
    pools: Pools,
    reach: NDArray[np.intp],
    tables: Tables,
    search_ns: tuple[float, float],
    threads: int,
) -> NDArray[np.bool_]:
    """Find the pixels around which background alone explains the counts.

    Parameters
    ----------
    seen : Photons
        Photons of all pixels.
    pools : Pools
        What the neighborhoods of all pixels hold.
    reach : ndarray of int, shape (row, col)
        Reach of the square that the first estimate of the delay comes from.
    tables : Tables
        Waveforms of the instrument.
    search_ns : tuple of float
        Least and greatest delay.
    threads : int
        Threads that share the squares.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True where no surface was detected.
    """
    scales = np.ones_like(reach), reach, 2 * reach
    least = detection_threshold(search_ns) + 2 * log(len(scales))
    doubtful = ~_plain(pools, tables)
    absent = np.zeros(reach.shape, bool)
    if not doubtful.any():
        return absent
    found = likelihood_ratio(pools.windows[:, doubtful] * pools.pixels[doubtful], tables)
    absent[doubtful] = ~(found >= least)
    doubtful &= ~absent
    for scale in scales:
        pixels = np.flatnonzero(doubtful)
        far, delays_ns = scale.ravel()[pixels], pools.delays_ns.ravel()[pixels]

        def some(part: tuple[int, int], pixels=pixels, far=far, delays_ns=delays_ns):
            chosen = slice(*part)
            counts = square_counts(
                seen,
                reach.shape,
                pixels[chosen],
                far[chosen].astype(np.int32),
                delays_ns[chosen],
                tables.windows,
                tables.cells_per_ns,
                tables.bands + 1,
            )
            return likelihood_ratio(counts.T, tables)

        if pixels.size:
            ratio = np.concatenate(in_parts(some, pixels.size, threads, threads))
            doubtful.ravel()[pixels[ratio >= least]] = False
    return absent | doubtful


def likelihood_ratio(counts: NDArray[np.floating], tables: Tables) -> NDArray[np.float64]:
    """Twice the log-likelihood ratio of pulses and background against background alone.

    Parameters
    ----------
    counts : ndarray, shape (window, pixel)
        Photons in the window of each band, and outside all of them, at some delay.
    tables : Tables
        Waveforms of the instrument.

    Returns
    -------
    ndarray of float, shape (pixel,)
        The ratio; bands with less light than background alone would give count as none.
    """
    total = counts.sum(axis=0, dtype=np.float64)
    # einsum, because a product of matrices would start threads that nobody asked for
    amounts = np.maximum(np.einsum("bw,wp->bp", tables.unmixing, counts, dtype=np.float64), 0)
    amounts[-1] = np.maximum(amounts[-1], BACKGROUND_SHARE * total)
    mean = np.einsum("wb,bp->wp", tables.mixing, amounts)
    mean *= total / np.maximum(mean.sum(axis=0), 1e-30)
    ratio = np.maximum(mean, 1e-30) / np.maximum(total * tables.mixing[:, -1:], 1e-30)
    return 2 * (counts * np.log(ratio)).sum(axis=0)


def _plain(pools: Pools, tables: Tables) -> NDArray[np.bool_]:
    """Whether the light in all windows together shows a surface without doubt, (row, col)."""
    background = pools.windows[-1]
    inside = pools.windows[:-1].sum(axis=0)
    share = np.float32(tables.mixing[:-1, -1].sum())
    total = np.maximum(inside + background, TINY)
    ratio = inside * np.log(np.maximum(inside, TINY) / (total * share))
    # windows that touch leave no bins for the background
    expected = np.maximum(total * (1 - share), TINY)
    ratio += background * np.log(np.maximum(background, TINY) / expected)
    return (inside > total * share) & (2 * ratio * pools.pixels > PLAIN)
