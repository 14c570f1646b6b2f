# SPDX-License-Identifier: Apache-2.0
"""Perceived difference of two colours: CIELAB and CIEDE2000."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_LINEAR_BELOW = (6 / 29) ** 3  #: relative luminance below which lightness is linear (CIE 15)


def lab(xyz: ArrayLike, /, *, white: ArrayLike) -> NDArray[np.float64]:
    """Convert tristimulus values to CIELAB (CIE 15:2018, section 8.2.1).

    Parameters
    ----------
    xyz : array_like, shape (..., 3)
        Tristimulus values X, Y, Z.
    white : array_like, shape (3,)
        Tristimulus values of white, on the same scale.

    Returns
    -------
    ndarray of float, shape (..., 3)
        L*, a* and b*.

    Examples
    --------
    >>> print(lab([0.2, 0.2, 0.2], white=[1, 1, 1]).round(2))
    [51.84  0.    0.  ]
    """
    ratio = np.asarray(xyz, dtype=np.float64) / np.asarray(white, dtype=np.float64)
    root = np.cbrt(np.maximum(ratio, 0))
    f = np.where(ratio > _LINEAR_BELOW, root, ratio * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e_2000(first: ArrayLike, second: ArrayLike, /) -> NDArray[np.float64]:
    """Compute the CIEDE2000 difference of CIELAB colours.

    Sharma, Wu and Dalal, Color Res. Appl. 30, 21 (2005), whose equation numbers the code gives. A
    difference of 1 is just noticeable.

    Parameters
    ----------
    first, second : array_like, shape (..., 3)
        L*, a* and b* of the colours to compare.

    Returns
    -------
    ndarray of float, shape (...)
        Differences ΔE₀₀.

    Examples
    --------
    >>> print(delta_e_2000([50, 2.6772, -79.7751], [50, 0, -82.7485]).round(4))
    2.0425
    """
    l1, a1, b1 = np.moveaxis(np.asarray(first, dtype=np.float64), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(second, dtype=np.float64), -1, 0)
    mean_chroma = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2  # (2), (3)
    stretch = 1.5 - 0.5 * _saturation(mean_chroma)  # 1 + G of (4)
    c1, c2 = np.hypot(a1 * stretch, b1), np.hypot(a2 * stretch, b2)  # (6)
    h1 = np.degrees(np.arctan2(b1, a1 * stretch)) % 360  # (7)
    h2 = np.degrees(np.arctan2(b2, a2 * stretch)) % 360

    grey = c1 * c2 == 0
    turn = np.where(grey, 0.0, (h2 - h1 + 180) % 360 - 180)  # (10), the short way round
    turn = np.where((turn == -180) & (h2 > h1), 180.0, turn)
    lightness, chroma = l2 - l1, c2 - c1  # (8), (9)
    hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2))  # (11)

    l_mean, c_mean = (l1 + l2) / 2, (c1 + c2) / 2  # (12), (13)
    h_sum = h1 + h2
    far = np.abs(h1 - h2) > 180
    h_mean = np.where(far, np.where(h_sum < 360, h_sum + 360, h_sum - 360), h_sum) / 2  # (14)
    h_mean = np.where(grey, h_sum, h_mean)
    t = (
        1
        - 0.17 * np.cos(np.radians(h_mean - 30))
        + 0.24 * np.cos(np.radians(2 * h_mean))
        + 0.32 * np.cos(np.radians(3 * h_mean + 6))
        - 0.20 * np.cos(np.radians(4 * h_mean - 63))
    )  # (15)
    from_middle = (l_mean - 50) ** 2
    s_lightness = 1 + 0.015 * from_middle / np.sqrt(20 + from_middle)  # (18)
    s_chroma = 1 + 0.045 * c_mean  # (19)
    s_hue = 1 + 0.015 * c_mean * t  # (20)
    blue = 60 * np.exp(-(((h_mean - 275) / 25) ** 2))  # 2 Δθ of (16)
    rotation = -np.sin(np.radians(blue)) * 2 * _saturation(c_mean)  # (17), (21)
    x, y, z = lightness / s_lightness, chroma / s_chroma, hue / s_hue
    return np.sqrt(np.maximum(x**2 + y**2 + z**2 + rotation * y * z, 0))  # (22)


def _saturation(chroma: NDArray[np.float64]) -> NDArray[np.float64]:
    """√(C⁷ / (C⁷ + 25⁷)), which turns corrections on for strong colours."""
    seventh = chroma**7
    return np.sqrt(seventh / (seventh + 25.0**7))
