# SPDX-License-Identifier: Apache-2.0
"""Smooth reflectance spectra for the 24 patches of a ColorChecker from their colour alone.

The patches' colours are those published by McCamy, Marcus and Davidson, "A Color-Rendition
Chart", J. Appl. Photogr. Eng. 2, 95 (1976): CIE 1931 x, y and Y under illuminant C. Infinitely
many spectra have the same colour; Burns' least hyperbolic tangent slope ("Numerical methods for
smoothest reflectance reconstruction", Color Res. Appl. 45, 8, 2020; method LHTSS) picks the
smoothest that stays between 0 and 1, which is close to what pigments do.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hueflight.color.observer import illuminant_power
from hueflight.model.spectra import WAVELENGTH_NM

#: name → (x, y, Y in percent), in reading order: four rows of six
PATCHES: dict[str, tuple[float, float, float]] = {
    "dark skin": (0.400, 0.350, 10.1),
    "light skin": (0.377, 0.345, 35.8),
    "blue sky": (0.247, 0.251, 19.3),
    "foliage": (0.337, 0.422, 13.3),
    "blue flower": (0.265, 0.240, 24.3),
    "bluish green": (0.261, 0.343, 43.1),
    "orange": (0.506, 0.407, 30.1),
    "purplish blue": (0.211, 0.175, 12.0),
    "moderate red": (0.453, 0.306, 19.8),
    "purple": (0.285, 0.202, 6.6),
    "yellow green": (0.380, 0.489, 44.3),
    "orange yellow": (0.473, 0.438, 43.1),
    "blue": (0.187, 0.129, 6.1),
    "green": (0.305, 0.478, 23.4),
    "red": (0.539, 0.313, 12.0),
    "yellow": (0.448, 0.470, 59.1),
    "magenta": (0.364, 0.233, 19.8),
    "cyan": (0.196, 0.252, 19.8),
    "white": (0.310, 0.316, 90.0),
    "neutral 8": (0.310, 0.316, 59.1),
    "neutral 6.5": (0.310, 0.316, 36.2),
    "neutral 5": (0.310, 0.316, 19.8),
    "neutral 3.5": (0.310, 0.316, 9.0),
    "black": (0.310, 0.316, 3.1),
}

_NODES_NM = np.arange(380.0, 731.0, 10.0)


def color_matching(wavelength_nm: NDArray[np.floating]) -> NDArray[np.float64]:
    """Approximate the CIE 1931 colour matching functions.

    The multi-lobe fit of Wyman, Sloan and Shirley, J. Comput. Graph. Tech. 2(2), 1 (2013).
    Colours of images are computed with the tabulated functions (`observer.tristimulus`). This fit
    only defines the spectra of the patches: the tabulated functions would change them by at most
    0.013 (root mean square 0.0015, CIEDE2000 at most 0.31), and with them every simulated chart.

    Parameters
    ----------
    wavelength_nm : ndarray of float, shape (wavelength,)
        Wavelengths, nm.

    Returns
    -------
    ndarray of float, shape (3, wavelength)
        The functions for X, Y and Z.
    """

    def lobe(peak: float, center: float, below: float, above: float) -> NDArray[np.float64]:
        slope = np.where(wavelength_nm < center, below, above)
        return peak * np.exp(-0.5 * ((wavelength_nm - center) * slope) ** 2)

    return np.array([
        lobe(0.362, 442.0, 0.0624, 0.0374)
        + lobe(1.056, 599.8, 0.0264, 0.0323)
        + lobe(-0.065, 501.1, 0.0490, 0.0382),
        lobe(0.821, 568.8, 0.0213, 0.0247) + lobe(0.286, 530.9, 0.0613, 0.0322),
        lobe(1.217, 437.0, 0.0845, 0.0278) + lobe(0.681, 459.0, 0.0385, 0.0725),
    ])  # fmt: skip


def tristimulus_weights() -> NDArray[np.float64]:
    """Compute the weights that turn reflectances at the nodes into XYZ under illuminant C.

    Returns
    -------
    ndarray of float, shape (3, 36)
        Weights for X, Y and Z; white has Y = 1.
    """
    weights = color_matching(_NODES_NM) * illuminant_power(_NODES_NM, "C")
    return weights / weights[1].sum()


def smoothest_reflectance(
    xyz: NDArray[np.floating], weights: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Find the smoothest reflectance within 0..1 with given tristimulus values (LHTSS).

    Parameters
    ----------
    xyz : ndarray of float, shape (3,)
        Tristimulus values, white at Y = 1.
    weights : ndarray of float, shape (3, wavelength)
        Weights such that ``weights @ reflectance`` gives `xyz`.

    Returns
    -------
    ndarray of float, shape (wavelength,)
        The reflectance.
    """
    count = weights.shape[1]
    # second difference with free ends: gradient of half the summed squared slopes
    slope = np.diff(np.eye(count), axis=0)
    stiffness = slope.T @ slope
    z, multipliers = np.zeros(count), np.zeros(3)
    for _ in range(100):
        reflectance = (np.tanh(z) + 1) / 2
        steepness = (1 - np.tanh(z) ** 2) / 2
        pull = weights.T @ multipliers
        residual = np.concatenate([
            stiffness @ z + steepness * pull,
            weights @ reflectance - xyz,
        ])  # fmt: skip
        if np.abs(residual).max() < 1e-10:
            return reflectance
        bend = np.diag(-2 * np.tanh(z) * steepness * pull)
        jacobian = np.block([
            [stiffness + bend, steepness[:, None] * weights.T],
            [weights * steepness, np.zeros((3, 3))],
        ])  # fmt: skip
        step = np.linalg.solve(jacobian, -residual)
        step *= min(1.0, 1.5 / np.abs(step[:count]).max())  # tanh saturates: no leaps
        z, multipliers = z + step[:count], multipliers + step[count:]
    raise ArithmeticError(f"no smooth reflectance found for XYZ = {xyz}")


def titanium_white(wavelength_nm: NDArray[np.floating]) -> NDArray[np.float64]:
    """Compute the reflectance of titanium dioxide (rutile): an edge at its band gap, 3.1 eV."""
    return 1 / (1 + np.exp(-(wavelength_nm - 398.0) / 8.0))


@lru_cache(maxsize=1)
def patch_reflectances() -> NDArray[np.float64]:
    """Compute the reflectance of the 24 patches.

    A colour hardly determines the violet end of a spectrum, so the white base of the paints is
    included: titanium dioxide, which absorbs below about 400 nm. Beyond 730 nm a spectrum is
    constant.

    Returns
    -------
    ndarray of float, shape (24, wavelength)
        Reflectances at `hueflight.model.spectra.WAVELENGTH_NM`.
    """
    base = titanium_white(_NODES_NM)
    weights = tristimulus_weights()
    # the tables' rounding and the fit of the matching functions move the white point a little
    white = weights.sum(axis=1)
    published_white = np.array([0.3101 / 0.3162, 1.0, (1 - 0.3101 - 0.3162) / 0.3162])
    spectra = []
    for x, y, percent in PATCHES.values():
        xyz = np.array([x / y, 1.0, (1 - x - y) / y]) * percent / 100
        nodes = smoothest_reflectance(xyz * white / published_white, weights * base)
        spectra.append(np.interp(WAVELENGTH_NM, _NODES_NM, nodes))
    return np.array(spectra) * titanium_white(WAVELENGTH_NM)
