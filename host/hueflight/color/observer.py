# SPDX-License-Identifier: Apache-2.0
"""The standard observer: tristimulus values of reflectances, and sRGB from those.

The table holds the CIE 1931 colour matching functions (2°) and the relative powers of the
standard illuminants C and D65 from 380 to 780 nm by 5 nm, as published by the CIE
(ISO/CIE 11664-1:2019; CIE 15:2018, tables T.1 and T.4).
"""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Illuminant = Literal["C", "D65"]
_COLUMN_OF_POWER: dict[Illuminant, int] = {"C": 4, "D65": 5}

# XYZ → linear sRGB (IEC 61966-2-1:1999)
_TO_LINEAR = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)


@lru_cache(maxsize=1)
def _table() -> NDArray[np.float64]:
    text = files("hueflight.color").joinpath("cie_5nm.csv").read_text(encoding="utf-8")
    return np.array([[float(entry) for entry in line.split(",")] for line in text.split()[1:]])


def illuminant_power(wavelength_nm: ArrayLike, /, illuminant: Illuminant) -> NDArray[np.float64]:
    """Look up the relative power of a standard illuminant.

    Parameters
    ----------
    wavelength_nm : array_like, shape (wavelength,)
        Wavelengths, nm; between the rows of the table the power is interpolated.
    illuminant : {"C", "D65"}
        The illuminant.

    Returns
    -------
    ndarray of float, shape (wavelength,)
        Power, 100 at 560 nm for D65; 0 outside 380 to 780 nm.
    """
    values = _table()
    power = values[:, _COLUMN_OF_POWER[illuminant]]
    nodes = np.asarray(wavelength_nm, np.float64)
    return np.interp(nodes, values[:, 0], power, left=0, right=0)


def tristimulus(
    wavelength_nm: ArrayLike, /, *, illuminant: Illuminant = "D65"
) -> NDArray[np.float64]:
    """Compute the weights that turn a sampled reflectance into XYZ.

    Parameters
    ----------
    wavelength_nm : array_like, shape (wavelength,)
        Evenly spaced samples, 380 to 780 nm or more, no more than 10 nm apart.
    illuminant : {"D65", "C"}
        The light under which the surface is seen.

    Returns
    -------
    ndarray of float, shape (3, wavelength)
        Weights for X, Y and Z; white has Y = 1.
    """
    nodes = np.asarray(wavelength_nm, np.float64)
    table = _table()
    power = table[:, _COLUMN_OF_POWER[illuminant]]
    weights = np.array(
        [
            np.interp(nodes, table[:, 0], table[:, column] * power, left=0, right=0)
            for column in (1, 2, 3)
        ]
    )
    return weights / weights[1].sum()


def srgb_of(xyz: ArrayLike, /) -> NDArray[np.float64]:
    """Convert XYZ under D65 to display values, clipped to the gamut.

    IEC 61966-2-1:1999, with white scaled to exactly (1, 1, 1).

    Parameters
    ----------
    xyz : array_like, shape (..., 3)
        Tristimulus values, white at Y = 1.

    Returns
    -------
    ndarray of float, shape (..., 3)
        Red, green and blue (sRGB) in 0..1.
    """
    return encoded(linear_of(xyz))


def linear_of(xyz: ArrayLike, /) -> NDArray[np.float64]:
    """Convert XYZ (..., 3) under D65 to linear sRGB (..., 3), not clipped."""
    white = _TO_LINEAR @ tristimulus(_table()[:, 0]).sum(axis=1)
    return np.asarray(xyz, np.float64) @ _TO_LINEAR.T / white


def encoded(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """Clip linear sRGB to 0..1 and apply the transfer curve."""
    light = np.clip(linear, 0, 1)
    return np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    )
