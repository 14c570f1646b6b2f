# SPDX-License-Identifier: Apache-2.0
"""From fitted photons to reflectances and their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.reference import Fit

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LightScale:
    """What makes photons to reflectances, and how well it is known.

    Attributes
    ----------
    gain : ndarray of float, shape (pixel,)
        Reflectance per photon of a band of brightness 1; NaN where there is no result.
    shared : ndarray of float, shape (pixel,)
        Relative variance that all bands of a pixel share.
    by_range : ndarray of float, shape (pixel,)
        Relative standard deviation that the distance adds.
    brightness : ndarray of float, shape (band,)
        Brightness of each band.
    uncertainty : ndarray of float, shape (band,)
        Its relative variance.
    misfit : float
        Factor of the variance of photon noise.
    """

    gain: _Floats
    shared: _Floats
    by_range: _Floats
    brightness: _Floats
    uncertainty: _Floats
    misfit: float


def reflectances(found: Fit, scale: LightScale) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the reflectances of fitted pixels.

    Parameters
    ----------
    found : Fit
        Fit of the pixels.
    scale : LightScale
        What makes photons to reflectances.

    Returns
    -------
    reflectance : ndarray of float32, shape (pixel, band)
        Reflectances.
    reflectance_std : ndarray of float32, shape (pixel, band)
        Their standard deviations.
    """
    gain = scale.gain[:, None] / scale.brightness
    relative = scale.shared[:, None] + scale.uncertainty
    photons = found.amplitude_std**2 * scale.misfit + found.amplitudes**2 * relative
    exact = gain * found.amplitudes
    spread = np.sqrt(gain**2 * photons + (exact * scale.by_range[:, None]) ** 2)
    return exact.astype(np.float32), spread.astype(np.float32)
