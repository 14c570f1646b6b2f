# SPDX-License-Identifier: Apache-2.0
"""What every method returns: plain arrays, not yet labeled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Estimates:
    """Result of a method for every pixel.

    Attributes
    ----------
    depth, depth_std : ndarray of float, shape (row, col)
        Depth along the optical axis and its standard deviation, m.
    reflectance, reflectance_std : ndarray of float, shape (band, row, col)
        Reflectance relative to the reference target and its standard deviation.
    background : ndarray of float, shape (row, col)
        Counts per code that the pulses do not explain.
    photons : ndarray of float, shape (row, col)
        Photons in the histogram of the pixel itself.
    quality : ndarray of uint16, shape (row, col)
        Bits of `Quality`.
    other_depth : ndarray of float, shape (row, col), or None
        Depth of the second lag of ambiguous pixels, else NaN, m. None from a method that looks for
        one depth only.
    resolution : ndarray of float, shape (row, col), or None
        Width in pixels of the square that holds as many pixels as the estimate rests on. None from
        a method that uses the photons of each pixel alone.
    white_photons : ndarray of float, shape (row, col), or None
        Photons that a reflectance of 1 in all bands would have given. None from a method whose
        amplitudes are not in photons.
    fit_chi_square : ndarray of float, shape (row, col), or None
        Pearson's χ² of the fit per degree of freedom, 1 on average; NaN without a depth and where
        counts do not scatter as Poisson counts. None from a method that does not test its fit.
    fit_p_value : ndarray of float, shape (row, col), or None
        Probability that a pixel with one surface fits as badly as this one; NaN and None likewise.
    second_depth, second_depth_std : ndarray of float, shape (row, col), or None
        Depth of the farther surface of pixels that see two and its standard deviation, else NaN,
        m. None from a method that looks for one surface only.
    near_reflectance, near_reflectance_std : ndarray of float, shape (band, row, col), or None
        Reflectance of the nearer surface alone of pixels that see two and its standard deviation;
        NaN where it is not known. None likewise.
    second_reflectance, second_reflectance_std : ndarray of float, shape (band, row, col), or None
        The same of the farther surface.
    near_share, near_share_std : ndarray of float, shape (row, col), or None
        Share of a mixed pixel's area that the near surface covers, and its standard deviation; NaN
        where it is not known. None likewise.
    """

    depth: NDArray[np.float64]
    depth_std: NDArray[np.float64]
    reflectance: NDArray[np.floating]
    reflectance_std: NDArray[np.floating]
    background: NDArray[np.float64]
    photons: NDArray[np.float64]
    quality: NDArray[np.uint16]
    other_depth: NDArray[np.float64] | None = None
    resolution: NDArray[np.float64] | None = None
    white_photons: NDArray[np.float64] | None = None
    fit_chi_square: NDArray[np.float64] | None = None
    fit_p_value: NDArray[np.float64] | None = None
    second_depth: NDArray[np.float64] | None = None
    second_depth_std: NDArray[np.float64] | None = None
    near_reflectance: NDArray[np.floating] | None = None
    near_reflectance_std: NDArray[np.floating] | None = None
    second_reflectance: NDArray[np.floating] | None = None
    second_reflectance_std: NDArray[np.floating] | None = None
    near_share: NDArray[np.float64] | None = None
    near_share_std: NDArray[np.float64] | None = None
