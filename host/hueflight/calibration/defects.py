# SPDX-License-Identifier: Apache-2.0
"""Hot and dead pixels, found from a reference and, where there is one, a dark capture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEAD_SHARE = 0.01  #: a pixel with less than this share of the median's photons is dead
HOT_MODULATION = 0.5  #: a pixel that follows the pulses less than half as well as the median
HOT_DARK_FACTOR = 50.0  #: a pixel with this many times the median's dark counts


def find_dead(photons: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Find pixels that detect (nearly) nothing of a target.

    Parameters
    ----------
    photons : ndarray of float, shape (row, col)
        Photons of each pixel.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True where a pixel has less than `DEAD_SHARE` of the median of all pixels that detected any.
    """
    lit = photons[photons > 0]
    if not lit.size:
        return np.ones(photons.shape, dtype=bool)
    return photons < DEAD_SHARE * np.median(lit)


def find_hot(
    light: NDArray[np.floating], pooled: NDArray[np.floating], dead: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Find pixels that fire independently of the LEDs.

    Such a pixel's histogram does not follow the pulse train: its correlation coefficient with the
    pooled train is far below that of the other pixels. Brightness is no criterion, because the
    target may be lit unevenly.

    Parameters
    ----------
    light : ndarray of float, shape (row, col, bin)
        Counts of the reference in time order, aligned to `pooled`.
    pooled : ndarray of float, shape (bin,)
        Counts of all pixels together.
    dead : ndarray of bool, shape (row, col)
        Dead pixels, which are left out.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True for a hot pixel.
    """
    shape = pooled - pooled.mean()
    # row by row, as doubles; the mean of `light` falls out: shape sums to 0
    centred = np.stack([row @ shape for row in light])
    count = light.shape[-1]
    variance = np.einsum("...b,...b->...", light, light) - light.sum(axis=-1) ** 2 / count
    spread = np.sqrt(np.maximum(variance, 0) * (shape @ shape))
    modulation = np.divide(centred, spread, out=np.zeros_like(spread), where=spread > 0)
    good = modulation[~dead]
    if not good.size:
        return np.zeros(dead.shape, dtype=bool)
    return ~dead & (modulation < HOT_MODULATION * np.median(good))


def find_hot_in_dark(
    photons: NDArray[np.floating], frames: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Find pixels whose dark counts per frame exceed `HOT_DARK_FACTOR` times the median.

    A pixel needs at least ten photons to be called hot, so that a short dark capture with mostly
    empty pixels marks none by chance.

    Parameters
    ----------
    photons : ndarray of float, shape (row, col)
        Photons of each pixel in a capture with the LEDs off.
    frames : ndarray of float, shape (row, col)
        Exposures behind them.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True for a hot pixel.
    """
    rate = photons / frames
    return (rate > HOT_DARK_FACTOR * np.median(rate)) & (photons >= 10)
