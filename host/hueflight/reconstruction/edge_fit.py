# SPDX-License-Identifier: Apache-2.0
"""Whether an edge pixel's counts are those of two surfaces that its neighbors show.

The neighbors tell the depths and the spectra of a near and of a far surface, so that only three
parameters are left: how much of each the pixel sees, and the background. Where both surfaces are
needed to explain the counts, and explain them as well as a free depth and spectrum do, the pixel
sees both. This finds mixed pixels of two colors even where their depth is one of the two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.tables import DelayTables, by_phase

NEEDED = 9.0  #: twice the log-likelihood that each surface must add
AS_GOOD = 26.0  #: and that a free depth and spectrum may add at most
ROUNDS = 4  #: of weighted least squares
LEAST_SHARE = 0.002  #: of a pixel's counts that is taken for background, at least
LEAST_COUNTS = 0.5  #: and this many

_Floats = NDArray[np.float64]


def sees_both(
    counts: _Floats, near: _Floats, far: _Floats, one: _Floats, background: _Floats
) -> NDArray[np.bool_]:
    """Tell the pixels whose counts need both surfaces.

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Counts of each pixel.
    near, far : ndarray, shape (pixel, bin)
        Expected counts if the pixel saw the near or the far surface alone, without background.
    one : ndarray, shape (pixel, bin)
        Expected counts of the fit with one depth and a free spectrum, with its background.
    background : ndarray, shape (bin,)
        Share of the background in each bin.

    Returns
    -------
    ndarray of bool, shape (pixel,)
        True where both are needed, and explain the counts about as well as the free fit.
    """
    flat = np.broadcast_to(background, counts.shape)
    alone = [greatest_likelihood(counts, [surface, flat]) for surface in (near, far)]
    needed = np.ones(len(counts), bool)
    both = np.maximum(greatest_likelihood(counts, [near, far, flat]), np.maximum(*alone))
    for single in alone:
        needed &= 2 * (both - single) > NEEDED
    total = counts.sum(axis=-1)
    mean = one * (total / one.sum(axis=-1))[:, None]
    free = (counts * np.log(mean)).sum(axis=-1) - total
    return needed & (2 * (free - both) < AS_GOOD)


def waveforms(level: DelayTables, delays_ns: _Floats, amplitudes: _Floats) -> _Floats:
    """Return the expected counts of pulses that arrive at given delays.

    Parameters
    ----------
    level : DelayTables
        Tables at the bins that are wanted.
    delays_ns : ndarray, shape (pixel,)
        Arrival in the pixel, its own delay included, ns.
    amplitudes : ndarray, shape (pixel, band)
        Photons of each band; negative ones count as none.

    Returns
    -------
    ndarray, shape (pixel, bin)
        Expected counts, without background.
    """
    light = np.empty((len(delays_ns), level.widths.size))
    positive = np.maximum(amplitudes, 0.0)
    for phase, chosen in by_phase(level.phase_of(delays_ns)):
        light[chosen] = positive[chosen] @ level.shares[phase]
    return light


def greatest_likelihood(counts: _Floats, parts: Sequence[_Floats]) -> _Floats:
    """Return the greatest log-likelihood of counts as a sum of parts, but for a constant.

    Weighted least squares with the model's own variances, from equal parts on.

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Counts of each pixel.
    parts : sequence of ndarray, shape (pixel, bin)
        Expected counts of each part on any scale, the background last. A part that comes out
        negative is left at 0.

    Returns
    -------
    ndarray of float, shape (pixel,)
        The log-likelihood.
    """
    total = counts.sum(axis=-1)
    floor = LEAST_SHARE * total + LEAST_COUNTS
    size = len(parts)
    sums = [part.sum(axis=-1) + 1e-30 for part in parts]
    theta: _Floats = np.stack([total / size / whole for whole in sums]).astype(np.float64)
    mean = np.empty_like(counts)
    normal, right = np.empty((len(counts), size, size)), np.empty((len(counts), size, 1))
    for _ in range(ROUNDS):
        mean = _sum_of(parts, theta, floor)
        weight = 1 / mean
        for i, one in enumerate(parts):
            weighted = weight * one
            right[:, i, 0] = np.einsum("pg,pg->p", weighted, counts)
            for j in range(i, size):
                value = np.einsum("pg,pg->p", weighted, parts[j])
                normal[:, i, j] = normal[:, j, i] = value
        normal[:, range(size), range(size)] *= 1 + 1e-6
        normal[:, range(size), range(size)] += 1e-12
        theta = np.linalg.solve(normal, right)[..., 0].T.astype(np.float64)
    mean = _sum_of(parts, theta, floor)
    return (counts * np.log(mean)).sum(axis=-1) - mean.sum(axis=-1)


def _sum_of(parts: Sequence[_Floats], theta: _Floats, floor: _Floats) -> _Floats:
    *surfaces, flat = parts
    mean = np.maximum(theta[-1], floor)[:, None] * flat
    for part, factor in zip(surfaces, theta, strict=False):
        mean = mean + np.maximum(factor, 0.0)[:, None] * part
    return mean
