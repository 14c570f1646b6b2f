"""Hot and dead pixels, found from a reference and, where there is one, a dark capture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEAD_SHARE = 0.01  #: a pixel with less than this share of the median's photons is dead
HOT_MODULATION = 0.5  #: a pixel that follows the pulses less than half as well as the median
HOT_DARK_FACTOR = 50.0  #: a pixel with this many times the median's dark counts


def find_dead(photons: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Pixels that see (nearly) nothing of an evenly lit target; photons (row, col)."""
    lit = photons[photons > 0]
    if not lit.size:
        return np.ones(photons.shape, dtype=bool)
    return photons < DEAD_SHARE * np.median(lit)


def find_hot(
    light: NDArray[np.floating], pooled: NDArray[np.floating], dead: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Pixels that fire whatever the LEDs do.

    Such a pixel's histogram does not follow the pulse train: its correlation coefficient with
    the pooled train is far below the other pixels'. Brightness alone would not do, for the
    target may be lit unevenly.

    Parameters
    ----------
    light : (row, col, bin) counts of the reference in time order, aligned to `pooled`.
    pooled : (bin,) counts of all pixels.
    dead : (row, col), left out.
    """
    shape = pooled - pooled.mean()
    centred = light @ shape  # the mean of `light` falls out: shape sums to 0
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
    """Pixels whose dark counts per frame exceed fifty times the median; both (row, col).

    The threshold has a floor of ten photons, so that a short dark capture with mostly empty
    pixels condemns none by chance.
    """
    rate = photons / frames
    return (rate > HOT_DARK_FACTOR * np.median(rate)) & (photons >= 10)
