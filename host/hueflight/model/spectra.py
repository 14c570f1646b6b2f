# SPDX-License-Identifier: Apache-2.0
"""Spectra of LEDs, detector and surfaces on one wavelength grid, and what bands detect of them."""

from __future__ import annotations

from collections.abc import Callable
from math import acosh

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.errors import SceneError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Band, Instrument

WAVELENGTH_NM = np.arange(300.0, 1701.0, 2.0)  #: grid of every spectrum here, nm
PLANCK_J_S = 6.62607015e-34  #: Planck's constant, exact, SI

# Reflectances are smooth over some nanometres, so a narrower line sees the same; the grid must
# still resolve it.
_NARROWEST_LINE_NM = 4.0

Spectrum = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def emission(band: Band, wavelength_nm: ArrayLike = WAVELENGTH_NM) -> NDArray[np.float64]:
    """Compute the emission spectrum of an LED from its peak and width.

    Both flanks of an LED's spectrum fall exponentially: the high-energy one with temperature
    (Boltzmann), the low-energy one with disorder (Urbach; Schubert, Light-Emitting Diodes,
    2nd ed., 5.2 and 7.1). A hyperbolic secant of two widths has this shape. In AlInGaP (red to
    amber) the short-wave flank is the wider one, in InGaN (green to violet) the long-wave one,
    by about the shares used here.

    Parameters
    ----------
    band : Band
        The LED.
    wavelength_nm : array_like
        Wavelengths, nm.

    Returns
    -------
    ndarray of float
        Emitted power per nm relative to the peak, in the shape of `wavelength_nm`.
    """
    short_wave_share = 0.58 if band.wavelength_nm > 570 else 0.48
    offset = np.asarray(wavelength_nm, dtype=np.float64) - band.wavelength_nm
    fwhm = max(band.spectral_fwhm_nm, _NARROWEST_LINE_NM)
    half_width = fwhm * np.where(offset < 0, short_wave_share, 1 - short_wave_share)
    return 1 / np.cosh(np.clip(offset * acosh(2) / half_width, -700, 700))


def detection(
    instrument: Instrument, wavelength_nm: ArrayLike = WAVELENGTH_NM
) -> NDArray[np.float64]:
    """Compute the probability that a photon that reaches the lens is detected.

    The stated transmission of the lens holds for the middle of the visible; towards the violet,
    glass and coatings of machine-vision lenses absorb more (half at 390 nm here). Without a table
    of detection probabilities the detector counts every photon.

    Parameters
    ----------
    instrument : Instrument
        Instrument with the lens and the detector.
    wavelength_nm : array_like
        Wavelengths, nm.

    Returns
    -------
    ndarray of float
        Transmission of the lens times detection probability, in the shape of `wavelength_nm`.
    """
    wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
    sensor = instrument.sensor
    detected = np.ones_like(wavelength_nm)
    if sensor.detection_wavelength_nm:
        nodes, table = sensor.detection_wavelength_nm, sensor.detection_probability
        detected = np.interp(wavelength_nm, nodes, table)
    if instrument.lens is None:
        return detected
    glass = 1 / (1 + np.exp(-(wavelength_nm - 390) / 12))
    return detected * instrument.lens.transmission * glass


def band_weights(instrument: Instrument) -> NDArray[np.float64]:
    """Compute the share of a band's detected photons at each wavelength.

    A measurement relative to a white reference gives the mean of a reflectance under these weights.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose bands and detector apply.

    Returns
    -------
    ndarray of float, shape (band, wavelength)
        Weights at `WAVELENGTH_NM`; each row sums to 1.

    Raises
    ------
    SceneError
        If a band lies outside the grid, or the detector registers nothing of it.
    """
    low, high = WAVELENGTH_NM[0] + 50, WAVELENGTH_NM[-1] - 50
    for band in instrument.bands:
        if not low <= band.wavelength_nm <= high:
            raise SceneError(
                f"band {band.name!r} at {band.wavelength_nm} nm: surfaces are described from "
                f"{low:g} to {high:g} nm only"
            )
    # photons, not power: times the wavelength
    sensed = WAVELENGTH_NM * detection(instrument)
    weights = np.array([emission(band) for band in instrument.bands]) * sensed
    totals = weights.sum(axis=1, keepdims=True)
    if not np.all(totals > 0):
        unseen = instrument.bands[int(np.argmin(totals))].name
        raise SceneError(f"band {unseen!r}: the detector registers no light there")
    return weights / totals


def mean_detection(instrument: Instrument) -> NDArray[np.float64]:
    """Compute the detected photons per joule of each band's light at the lens.

    Planck's constant times the speed of light converts energy into photons (SI, exact).

    Parameters
    ----------
    instrument : Instrument
        Instrument whose bands, lens and detector apply.

    Returns
    -------
    ndarray of float, shape (band,)
        Detected photons per joule.
    """
    joule_nm = PLANCK_J_S * (SPEED_OF_LIGHT_M_PER_NS * 1e18)  # in nm/s
    sensed = WAVELENGTH_NM / joule_nm * detection(instrument)
    shapes = np.array([emission(band) for band in instrument.bands])
    return shapes @ sensed / shapes.sum(axis=1)


# -- surfaces ---------------------------------------------------------------------------------


def _rise(at_nm: float, width_nm: float) -> Spectrum:
    return lambda nm: 1 / (1 + np.exp(-np.clip((nm - at_nm) / width_nm, -60, 60)))


def _bell(at_nm: float, width_nm: float) -> Spectrum:
    return lambda nm: np.exp(-0.5 * ((nm - at_nm) / width_nm) ** 2)


def _sum(base: float, *parts: tuple[float, Spectrum]) -> Spectrum:
    return lambda nm: np.full_like(nm, base) + sum(share * part(nm) for share, part in parts)


# Pigmented plastics: an absorption edge (reds, yellows) or a hump between absorptions (greens,
# blues), and most turn bright again in the deep red.
_PIGMENTS: dict[str, Spectrum] = {
    "white": _sum(1.0),
    "grey": _sum(0.42),
    "black": _sum(0.035),
    # bleached cellulose: flat, falling where lignin and brighteners absorb
    "paper": _sum(0.55, (0.35, _rise(405, 12))),
    "red brick": _sum(0.045, (0.66, _rise(603, 11))),
    "green brick": _sum(0.04, (0.36, _bell(524, 33)), (0.30, _rise(720, 16))),
    "blue brick": _sum(0.035, (0.42, _bell(455, 38)), (0.38, _rise(715, 18))),
    "purple brick": _sum(0.055, (0.26, _bell(438, 36)), (0.40, _rise(648, 20))),
    "yellow brick": _sum(0.05, (0.70, _rise(512, 13))),
    "seam": _sum(0.02, (0.05, _rise(600, 40))),
    "horse": _sum(0.06, (0.40, _rise(588, 34))),
    "hoof": _sum(0.05, (0.03, _rise(600, 60))),
    "saddle": _sum(0.05, (0.52, _bell(482, 42)), (0.35, _rise(725, 18))),
    "board": _sum(0.50, (0.28, _rise(412, 14))),
    "shelf": _sum(0.10, (0.06, _rise(590, 45))),
    "ink red": _sum(0.05, (0.72, _rise(605, 13))),
    "ink orange": _sum(0.06, (0.72, _rise(575, 13))),
    "ink amber": _sum(0.06, (0.72, _rise(540, 14))),
    "ink yellow": _sum(0.07, (0.72, _rise(508, 13))),
    "ink green": _sum(0.05, (0.50, _bell(528, 34)), (0.25, _rise(725, 18))),
    "ink cyan": _sum(0.06, (0.62, _bell(492, 42)), (0.25, _rise(730, 18))),
    "ink blue": _sum(0.05, (0.55, _bell(458, 34)), (0.30, _rise(720, 18))),
    "ink violet": _sum(0.07, (0.50, _bell(428, 34)), (0.34, _rise(660, 20))),
    "ink navy": _sum(0.04, (0.16, _bell(450, 36)), (0.20, _rise(730, 18))),
}


def surface_names() -> tuple[str, ...]:
    """List the surfaces that `reflectance` knows.

    Returns
    -------
    tuple of str
        Names of the surfaces.
    """
    return tuple(_PIGMENTS)


def reflectance(surface: str | float) -> NDArray[np.float64]:
    """Compute the reflectance of a named surface, or of a grey one.

    Parameters
    ----------
    surface : str or float
        Name of a surface (see `surface_names`), or one reflectance in 0..1 for all wavelengths.

    Returns
    -------
    ndarray of float, shape (wavelength,)
        Reflectance at `WAVELENGTH_NM`.

    Raises
    ------
    SceneError
        If there is no such surface or the value lies outside 0..1.
    """
    if isinstance(surface, str):
        if surface not in _PIGMENTS:
            raise SceneError(
                f"no surface {surface!r}; there are {', '.join(_PIGMENTS)}, "
                "or give a reflectance from 0 to 1"
            )
        return _PIGMENTS[surface](WAVELENGTH_NM)
    if not 0 <= surface <= 1:
        raise SceneError(f"reflectance {surface!r}: must lie in 0..1")
    return np.full_like(WAVELENGTH_NM, surface)
