# SPDX-License-Identifier: Apache-2.0
"""Pile-up: what a sensor that records one photon per exposure loses, and its correction.

An exposure spans one or many periods. Whether a photon is recorded depends on how many came
before it: over the whole exposure, bright pixels appear darker than they are, and within a
period, late pulses appear fainter than early ones (Coates, J. Phys. E 1, 878, 1968).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.model.instrument import Instrument

SMALL = 1e-4  #: below which (sinh x / x)² = 1 + x²/3 to double precision
NEGLIGIBLE = 1e-3  #: photons per period below which the loss within it is not corrected


def periods_per_exposure(instrument: Instrument) -> int:
    """Compute the number of whole periods in one exposure.

    Parameters
    ----------
    instrument : Instrument
        Instrument whose period and exposure time apply.

    Returns
    -------
    int
        Number of periods; 1 where the instrument states no exposure time or no period, because an
        exposure is then one pass of the time bins.
    """
    period_ns, exposure_ms = instrument.timing.period_ns, instrument.sensor.exposure_ms
    if period_ns is None or exposure_ms is None:
        return 1
    return max(1, round(exposure_ms * 1e6 / period_ns))


def lost_photons_factor(
    hits: NDArray[np.float64], frames: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the arrived photons per recorded photon, where an exposure records only its first.

    The mean number that arrived in an exposure is −ln(1 − hits/frames) (Poisson statistics).

    Parameters
    ----------
    hits : ndarray of float
        Exposures with a photon, any shape.
    frames : ndarray of float
        All exposures, same shape.

    Returns
    -------
    ndarray of float
        Factors of the same shape, 1 or more; NaN where every exposure holds a photon, because the
        number that arrived can't be known then.
    """
    occupancy = np.divide(hits, frames, out=np.zeros_like(hits), where=frames > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = -np.log1p(-occupancy) / occupancy
    factor[occupancy == 0] = 1.0
    factor[~np.isfinite(factor)] = np.nan
    return factor


def arrivals_per_exposure(
    hits: NDArray[np.float64], frames: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the mean number of photons that reach a pixel in one exposure.

    A pixel with a photon in every exposure is treated as if half an exposure had been empty.

    Parameters
    ----------
    hits : ndarray of float
        Exposures with a photon, any shape.
    frames : ndarray of float
        All exposures, same shape.

    Returns
    -------
    ndarray of float
        Photons per exposure in the shape of `hits`.
    """
    recorded = np.maximum(np.minimum(hits, frames - 0.5), 0)
    return -np.log1p(-recorded / np.maximum(frames, 1e-300))


def photons_per_period(
    hits: NDArray[np.float64], frames: NDArray[np.float64] | None, instrument: Instrument
) -> NDArray[np.float64] | None:
    """Compute the mean number of photons that reach a pixel in one period.

    A pixel with a photon in every exposure is treated as if half an exposure had been empty.

    Parameters
    ----------
    hits : ndarray of float
        Exposures with a photon, any shape.
    frames : ndarray of float or None
        All exposures, same shape; None where their number can't be known.
    instrument : Instrument
        Instrument whose period and exposure time apply.

    Returns
    -------
    ndarray of float or None
        Photons per period in the shape of `hits`; None where they can't be known.
    """
    if frames is None:
        return None
    return arrivals_per_exposure(hits, frames) / periods_per_exposure(instrument)


def correction_weights(
    light: NDArray[np.floating], per_period: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute the factor by which Coates's correction multiplies the counts of each bin.

    Parameters
    ----------
    light : ndarray, shape (..., bin)
        Counts in time order.
    per_period : ndarray of float, shape (...)
        Photons per period, as `photons_per_period` gives.

    Returns
    -------
    ndarray of float, shape (..., bin)
        Weights, with which the sum of each pixel stays the same. A count that is corrected by w has
        w times the variance of a Poisson count of that size.
    """
    earlier = np.cumsum(light, axis=-1, dtype=np.float64)
    total = np.maximum(earlier[..., -1:], 1e-300)
    later = (earlier[..., -1:] - earlier + 0.5 * light) / total  # 1 − F
    rate = np.asarray(per_period)[..., None]
    weights = 1 / (np.exp(-rate) - later * np.expm1(-rate))
    corrected = (light * weights).sum(axis=-1, keepdims=True)
    return weights * total / np.maximum(corrected, 1e-300)


def variance_factor(arrivals: NDArray[np.floating] | float) -> NDArray[np.float64]:
    """Compute how much more counts scatter after the correction of lost photons.

    The number of photons that arrived is estimated as −n ln(1 − hits/n). Its relative variance is
    (sinh(r/2) / (r/2))² / hits, with r arrivals for each of the n exposures. The same factor holds
    for the mean of counts that were divided by what was left of a period, with r arrivals in the
    period.

    Parameters
    ----------
    arrivals : ndarray of float
        Photons that arrive per exposure, or per period.

    Returns
    -------
    ndarray of float
        Factors, 1 or more.
    """
    half = np.maximum(np.asarray(arrivals, np.float64) / 2, 1e-9)
    if half.max(initial=0.0) < SMALL:
        return 1 + half**2 / 3
    return (np.sinh(half) / half) ** 2


def coates_correction(
    light: NDArray[np.floating], per_period: NDArray[np.floating] | None
) -> NDArray[np.floating]:
    """Correct counts for photons that were lost to an earlier photon of the same period.

    If r photons reach a pixel in a period, the share 1 − exp(−r) of the periods records one. When
    the share F of those has come, the share 1 − F (1 − exp(−r)) of all periods can still record a
    photon: counts are divided by this share (Coates, J. Phys. E 1, 878, 1968, with F taken in the
    middle of a bin) and scaled so that the sum of each pixel stays the same. Nothing is changed
    where no pixel receives more than `NEGLIGIBLE` photons per period.

    Parameters
    ----------
    light : ndarray, shape (..., bin)
        Counts in time order.
    per_period : ndarray of float, shape (...), or None
        Photons per period, as `photons_per_period` gives; None for no correction.

    Returns
    -------
    ndarray of float, shape (..., bin)
        Corrected counts.
    """
    if per_period is None or float(np.max(per_period, initial=0.0)) < NEGLIGIBLE:
        return light
    rates = np.asarray(per_period)
    if light.ndim < 3:
        return _corrected(light, rates)
    # row by row: the doubles of a whole capture would take several times its memory
    whole = np.empty(light.shape, _float_type(light))
    for row in range(len(light)):
        whole[row] = _corrected(light[row], rates[row])
    return whole


def _float_type(light: NDArray[np.floating]) -> np.dtype[np.floating]:
    return light.dtype if light.dtype.kind == "f" else np.dtype(np.float32)


def _corrected(
    light: NDArray[np.floating], per_period: NDArray[np.floating]
) -> NDArray[np.floating]:
    return (light * correction_weights(light, per_period)).astype(_float_type(light))
