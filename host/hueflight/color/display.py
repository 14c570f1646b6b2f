# SPDX-License-Identifier: Apache-2.0
"""Pictures for display: missing pixels filled, three bands as RGB. Not for measurements."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import convolve

from hueflight.errors import HueflightError

PAPER_RGB_NM = (623.0, 525.0, 445.0)  #: the bands of the paper's Fig. 4(j)
MAX_FILL_ROUNDS = 8  #: holes wider than twice this many pixels stay holes


def fill_missing(plane: NDArray[np.floating]) -> NDArray[np.float64]:
    """Replace missing pixels by the weighted mean of their known neighbours, ring by ring.

    Parameters
    ----------
    plane : ndarray of float, shape (row, col)
        Values; NaN where missing.

    Returns
    -------
    ndarray of float, shape (row, col)
        Values with holes filled, except the middle of holes wider than 16 pixels.
    """
    filled = np.array(plane, dtype=np.float64)
    around = np.array([[0.5, 1, 0.5], [1, 0, 1], [0.5, 1, 0.5]])
    for _ in range(MAX_FILL_ROUNDS):
        known = np.isfinite(filled)
        if known.all() or not known.any():
            break
        weight = convolve(known.astype(np.float64), around, mode="constant")
        total = convolve(np.where(known, filled, 0.0), around, mode="constant")
        fillable = ~known & (weight > 0)
        filled[fillable] = total[fillable] / weight[fillable]
    return filled


def three_band_rgb(
    image: xr.Dataset, /, *, wavelengths_nm: ArrayLike = PAPER_RGB_NM, gamma: float = 2.2
) -> NDArray[np.float64]:
    """Show three bands as red, green and blue, with missing pixels interpolated.

    This is the picture of the paper's Fig. 4(j). Each channel is scaled so that 98 % of its pixels
    are in range. For illustration only: three narrow bands are no colour measurement.

    Parameters
    ----------
    image : Dataset
        Image as `hueflight.reconstruct` gives.
    wavelengths_nm : array_like, shape (3,)
        Wavelengths for red, green and blue, nm; the nearest band is taken for each.
    gamma : float
        Exponent of the display; values are raised to its reciprocal.

    Returns
    -------
    ndarray of float, shape (row, col, 3)
        Red, green and blue in 0..1.

    Raises
    ------
    HueflightError
        If one of the bands has no pixel with a value.
    """
    available = image["wavelength"].values
    bands = [int(np.argmin(np.abs(available - w))) for w in np.atleast_1d(wavelengths_nm)]
    planes = []
    for band in bands:
        plane = image["reflectance"].values[:, :, band]
        if not np.isfinite(plane).any():
            raise HueflightError(
                f"the band at {available[band]:.0f} nm has no pixel with a value: nothing to show"
            )
        filled = fill_missing(plane)
        top = np.nanpercentile(filled, 98)
        scaled = np.clip(filled / top, 0, 1) if top > 0 else np.zeros_like(filled)
        planes.append(np.nan_to_num(scaled) ** (1 / gamma))
    return np.stack(planes, axis=-1)


def wavelength_colour(wavelength_nm: float) -> tuple[float, float, float]:
    """Choose a screen colour that represents a wavelength.

    Parameters
    ----------
    wavelength_nm : float
        Wavelength, nm.

    Returns
    -------
    tuple of float
        Red, green and blue in 0..1; grey outside the visible.
    """
    anchors_nm = [400, 420, 445, 470, 498, 525, 570, 597, 623, 645, 680]
    red = [0.42, 0.45, 0.22, 0.05, 0.00, 0.10, 0.70, 0.95, 0.93, 0.85, 0.60]
    green = [0.10, 0.15, 0.30, 0.45, 0.65, 0.65, 0.70, 0.65, 0.38, 0.15, 0.08]
    blue = [0.70, 0.80, 0.88, 0.90, 0.70, 0.20, 0.05, 0.05, 0.10, 0.12, 0.10]
    if not 380 <= wavelength_nm <= 720:
        return (0.45, 0.45, 0.45)
    r, g, b = (float(np.interp(wavelength_nm, anchors_nm, table)) for table in (red, green, blue))
    return r, g, b
