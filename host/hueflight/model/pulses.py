# SPDX-License-Identifier: Apache-2.0
"""Optical pulses: a Gaussian with an exponential tail, on the circle of the period.

LEDs rise faster than they fall. The exponentially modified Gaussian is the usual model of
such a pulse; its integral is known in closed form, so a bin's share is exact however narrow or
wide the bin is (Grushka, Anal. Chem. 44, 1733, 1972).

SciPy is imported inside the functions: loading it takes longer than reading an instrument or a
recording, which need this module and none of its integrals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, log, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.errors import InstrumentError

GAUSSIAN_FWHM_PER_SIGMA = 2 * sqrt(2 * log(2))
SHORT_TAIL = 1e-6  #: tails below this share of sigma differ from a Gaussian by less than 1e-12


@dataclass(frozen=True)
class Pulse:
    """One optical pulse: an exponentially modified Gaussian.

    Attributes
    ----------
    center_ns : float
        Centre of the Gaussian part, ns; the mean lies `tail_ns` later.
    sigma_ns : float
        Standard deviation of the Gaussian part, ns.
    tail_ns : float
        Decay constant of the exponential part, ns; 0 for a Gaussian pulse.
    area : float
        Number of photons in the pulse.
    """

    center_ns: float
    sigma_ns: float
    tail_ns: float = 0.0
    area: float = 1.0

    @property
    def _is_gaussian(self) -> bool:
        return self.tail_ns <= SHORT_TAIL * self.sigma_ns

    def density(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """Evaluate the photon rate at given times.

        Parameters
        ----------
        time_ns : array_like
            Times, ns.

        Returns
        -------
        ndarray of float
            Photons per ns, in the shape of `time_ns`.
        """
        z = (np.asarray(time_ns, dtype=np.float64) - self.center_ns) / self.sigma_ns
        if self._is_gaussian:
            return self.area * np.exp(-(z**2) / 2) / (self.sigma_ns * sqrt(2 * np.pi))
        return self.area * self._decayed(z) / self.tail_ns

    def cumulative(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """Evaluate the number of photons that have arrived up to given times.

        Parameters
        ----------
        time_ns : array_like
            Times, ns.

        Returns
        -------
        ndarray of float
            Photons, from 0 to `area`, in the shape of `time_ns`.
        """
        from scipy.special import ndtr

        z = (np.asarray(time_ns, dtype=np.float64) - self.center_ns) / self.sigma_ns
        if self._is_gaussian:
            return self.area * ndtr(z)
        return self.area * (ndtr(z) - self._decayed(z))

    def slope(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """Evaluate the derivative of `density` with respect to time.

        Parameters
        ----------
        time_ns : array_like
            Times, ns.

        Returns
        -------
        ndarray of float
            Photons per ns², in the shape of `time_ns`.
        """
        z = (np.asarray(time_ns, dtype=np.float64) - self.center_ns) / self.sigma_ns
        bell = self.area * np.exp(-(z**2) / 2) / (self.sigma_ns * sqrt(2 * np.pi))
        if self._is_gaussian:
            return -z / self.sigma_ns * bell
        return (bell - self.density(time_ns)) / self.tail_ns

    def _decayed(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """exp(s²/2 − s z) Φ(z − s) with s = σ/tail, written so that no factor overflows alone."""
        from scipy.special import erfcx

        s = self.sigma_ns / self.tail_ns
        past = z - s
        scaled = np.exp(-(z**2) / 2) * erfcx(-np.minimum(past, 30) / sqrt(2)) / 2
        return np.where(past < 30, scaled, np.exp(np.minimum(-s * (z - s / 2), 0)))

    def share(self, edges_ns: NDArray[np.floating], period_ns: float | None) -> NDArray[np.float64]:
        """Compute the number of photons between successive edges.

        Parameters
        ----------
        edges_ns : ndarray of float, shape (edge,)
            Edges in ascending order, ns.
        period_ns : float or None
            Period after which the pulse repeats, ns; None for a single pulse.

        Returns
        -------
        ndarray of float, shape (edge - 1,)
            Photons in each bin.
        """
        if period_ns is None:
            return np.diff(self.cumulative(edges_ns))
        turns = self._turns(period_ns)
        return np.diff(np.sum([self.cumulative(edges_ns + turn) for turn in turns], axis=0))

    def wrapped_density(
        self, time_ns: NDArray[np.floating], period_ns: float | None
    ) -> NDArray[np.float64]:
        """Evaluate the photon rate at given times, with the repetitions of the pulse added.

        Parameters
        ----------
        time_ns : ndarray of float
            Times, ns.
        period_ns : float or None
            Period after which the pulse repeats, ns; None for a single pulse.

        Returns
        -------
        ndarray of float
            Photons per ns, in the shape of `time_ns`.
        """
        if period_ns is None:
            return self.density(time_ns)
        turns = self._turns(period_ns)
        return np.sum([self.density(time_ns + turn) for turn in turns], axis=0)

    def _turns(self, period_ns: float) -> NDArray[np.float64]:
        """Whole periods to look into, so that less than 1e-15 of the pulse is left out."""
        earliest = self.center_ns - 8.5 * self.sigma_ns
        latest = self.center_ns + 8.5 * self.sigma_ns + 36 * self.tail_ns
        first, last = ceil(earliest / period_ns) - 1, ceil(latest / period_ns)
        return np.arange(first - 1, last + 1, dtype=np.float64) * np.float64(period_ns)


@lru_cache(maxsize=1024)
def full_width_half_maximum(sigma_ns: float, tail_ns: float) -> float:
    """Compute the full width at half maximum (FWHM) of an exponentially modified Gaussian.

    Parameters
    ----------
    sigma_ns : float
        Standard deviation of the Gaussian part, ns.
    tail_ns : float
        Decay constant of the exponential part, ns.

    Returns
    -------
    float
        FWHM, ns.
    """
    from scipy.optimize import brentq

    if tail_ns <= SHORT_TAIL * sigma_ns:
        return GAUSSIAN_FWHM_PER_SIGMA * sigma_ns
    pulse = Pulse(0.0, sigma_ns, tail_ns)
    # the mode lies where the slope changes sign, between the Gaussian's centre and its mean
    mode = float(brentq(lambda t: float(pulse.slope(t)), -sigma_ns, tail_ns + sigma_ns, xtol=1e-12))
    half = float(pulse.density(mode)) / 2

    def above_half(time_ns: float) -> float:
        return float(pulse.density(time_ns)) - half

    rise = brentq(above_half, mode - 8 * sigma_ns, mode, xtol=1e-12)
    fall = brentq(above_half, mode, mode + 8 * (sigma_ns + tail_ns), xtol=1e-12)
    return float(fall - rise)


@lru_cache(maxsize=1024)
def gaussian_sigma(fwhm_ns: float, tail_ns: float) -> float:
    """Compute the width of the Gaussian part from the FWHM of the whole pulse.

    Parameters
    ----------
    fwhm_ns : float
        Full width at half maximum of the pulse, ns.
    tail_ns : float
        Decay constant of the exponential part, ns.

    Returns
    -------
    float
        Standard deviation of the Gaussian part, ns.

    Raises
    ------
    InstrumentError
        If the tail alone is already as wide (tail · ln 2 ≥ 0.98 FWHM).
    """
    if tail_ns * log(2) >= 0.98 * fwhm_ns:
        raise InstrumentError(
            f"a tail of {tail_ns} ns is alone as wide as the whole pulse of {fwhm_ns} ns "
            "(at half maximum): shorten the tail or widen the pulse"
        )
    from scipy.optimize import brentq

    widest = fwhm_ns / GAUSSIAN_FWHM_PER_SIGMA
    if tail_ns <= SHORT_TAIL * widest:
        return widest
    return float(
        brentq(
            lambda sigma: full_width_half_maximum(sigma, tail_ns) - fwhm_ns,
            1e-3 * widest,
            widest,
            xtol=1e-12,
        )
    )
