# SPDX-License-Identifier: Apache-2.0
"""Spectra from bands: a Wiener estimate that weighs each band by its noise.

A band measures the mean of a reflectance under its LED's spectrum, which is some tens of
nanometres wide and overlaps its neighbours'. With a prior of smooth spectra and the noise of the
bands, the linear estimate of least error is x ↦ m + P Sᵀ(S P Sᵀ + N)⁻¹(x − S m) (Pratt and
Mancill, Appl. Opt. 15, 73, 1976). The prior here is relative to a surface's own brightness, so
that dark surfaces are not taken for noise and the light level does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.color.observer import Illuminant, tristimulus
from hueflight.errors import HueflightError
from hueflight.model.emission import Emission
from hueflight.model.instrument import Instrument

NODES_NM = np.arange(300.0, 1101.0, 5.0)  #: where a spectrum is sampled
#: Prior of a reflectance relative to its mean over the bands: a Matérn-3/2 process (continuous,
#: with kinks as at absorption edges) of this length about a level of this variance. Any length
#: from 60 to 120 nm serves surfaces equally well.
LENGTH_NM = 80.0
LEVEL_VARIANCE = 1.0
#: Surfaces are neutral, pale or colourful: the process has one of these variances, and how well
#: each explains the bands is its weight. So noise on a grey is not taken for a colour.
VARIANCES = (0.002, 0.03, 0.5)
LEAST_NOISE = 0.002  #: deviation that is always allowed for, relative to the mean over the bands
UNKNOWN = 1e6  #: variance of a band that says nothing


@dataclass(frozen=True, eq=False)
class SpectralModel:
    """How an instrument's bands sample a spectrum, and a prior of spectra.

    Attributes
    ----------
    shares : ndarray of float, shape (band, node)
        Share of each band's detected photons at `NODES_NM`; each row sums to 1.
    brightness : ndarray of float, shape (band,)
        Relative photons of each band from a white surface; they sum to 1.
    wavelengths_nm : ndarray of float, shape (band,)
        Nominal wavelength of each band, nm.
    """

    shares: NDArray[np.float64]
    brightness: NDArray[np.float64]
    wavelengths_nm: NDArray[np.float64]

    @classmethod
    def of(cls, instrument: Instrument, emission: Emission | None = None, /) -> SpectralModel:
        """Make the model of an instrument.

        Parameters
        ----------
        instrument : Instrument
            Instrument with the bands and the detector.
        emission : Emission or None
            Measured spectra of the LEDs; None for those that the instrument states.

        Returns
        -------
        SpectralModel
            Model of all bands.
        """
        emission = Emission.nominal(instrument) if emission is None else emission
        brightness = instrument.band_brightness()
        return cls(
            shares=emission.shares(instrument, NODES_NM),
            brightness=brightness / brightness.sum(),
            wavelengths_nm=instrument.wavelengths_nm,
        )

    def of_bands(self, bands: Sequence[int]) -> SpectralModel:
        """Restrict the model to some of the bands.

        Parameters
        ----------
        bands : sequence of int
            Indices of the bands, in the wanted order.

        Returns
        -------
        SpectralModel
            Model of these bands.
        """
        chosen = list(bands)
        brightness = self.brightness[chosen]
        return SpectralModel(
            self.shares[chosen], brightness / brightness.sum(), self.wavelengths_nm[chosen]
        )

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Prior correlation of relative spectra between wavelengths, shape (node, node)."""
        apart = np.sqrt(3) * np.abs(NODES_NM[:, None] - NODES_NM) / LENGTH_NM
        return (1 + apart) * np.exp(-apart)

    def at(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Make the query for `recover` that asks for the reflectance at single wavelengths.

        Parameters
        ----------
        wavelength_nm : array_like, shape (wavelength,)
            Wavelengths, nm.

        Returns
        -------
        ndarray of float, shape (wavelength, node)
            Weights on the spectrum at `NODES_NM`.

        Raises
        ------
        HueflightError
            If a wavelength lies outside the nodes.
        """
        wanted = np.atleast_1d(np.asarray(wavelength_nm, np.float64))
        if not ((wanted >= NODES_NM[0]) & (wanted <= NODES_NM[-1])).all():
            raise HueflightError(
                f"wavelengths {wanted.tolist()} nm: spectra reach from {NODES_NM[0]:g} to "
                f"{NODES_NM[-1]:g} nm"
            )
        return np.array([np.interp(wanted, NODES_NM, unit) for unit in np.eye(NODES_NM.size)]).T

    def linear(
        self, query: NDArray[np.floating], *, noise: float = LEAST_NOISE
    ) -> NDArray[np.float64]:
        """Compute one linear map for all pixels: the estimate for bands of the same known noise.

        Parameters
        ----------
        query : ndarray of float, shape (query, node)
            Weights on the spectrum at `NODES_NM`, such as `at` and `to_xyz` give.
        noise : float
            Standard deviation of each band's reflectance.

        Returns
        -------
        ndarray of float, shape (query, band)
            Weights on the reflectances of the bands.
        """
        # at the mean square reflectance of coloured surfaces
        prior = 0.1 * (VARIANCES[-1] * self.correlation + LEVEL_VARIANCE)
        seen = self.shares @ prior
        normal = seen @ self.shares.T + noise**2 * np.eye(len(self.shares))
        solved = np.linalg.solve(normal, seen @ np.asarray(query, np.float64).T)
        return np.asarray(solved.T, np.float64)

    def recover(
        self,
        reflectance: ArrayLike,
        deviation: ArrayLike,
        query: NDArray[np.floating],
        /,
        *,
        per_photon: ArrayLike | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Estimate linear quantities of the spectrum behind measured bands, and their uncertainty.

        Parameters
        ----------
        reflectance : array_like, shape (..., band)
            Reflectances as `hueflight.reconstruct` gives; NaN where a band is not known.
        deviation : array_like, shape (..., band)
            Their standard deviations.
        query : ndarray of float, shape (query, node)
            Weights on the spectrum at `NODES_NM`, such as `at` and `to_xyz` give.
        per_photon : array_like or None, shape (..., band)
            Reflectance that one photon stands for. With it the variances are those of the expected
            photons and not of the counted ones, which matters where a band holds few.

        Returns
        -------
        values : ndarray of float, shape (..., query)
            The quantities; NaN where no band is known.
        deviations : ndarray of float, shape (..., query)
            Their standard deviations.

        Raises
        ------
        HueflightError
            If the shapes do not agree.
        """
        measured = np.asarray(reflectance, np.float64)
        variance = np.asarray(deviation, np.float64) ** 2
        if measured.shape != variance.shape or measured.shape[-1:] != self.brightness.shape:
            raise HueflightError(
                f"reflectance {measured.shape} and deviation {variance.shape} must both be "
                f"(…, {self.brightness.size}): one value for each band"
            )
        known = np.isfinite(measured) & np.isfinite(variance)
        x = np.where(known, measured, 0.0)
        weight = np.where(known, self.brightness, 0.0)
        weight = weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-300)
        level = (weight * x).sum(axis=-1, keepdims=True)
        own = (weight**2 * np.where(known, variance, 0)).sum(axis=-1, keepdims=True)
        level = np.maximum(np.maximum(level, np.sqrt(own)), 1e-12)

        x, noise = x / level, np.where(known, variance / level**2 + LEAST_NOISE**2, UNKNOWN)
        white = self.shares.sum(axis=1)  # what the mean, a level of 1, gives: ones
        expected, _ = self._explained(x - white, noise, self.shares)
        if per_photon is not None:
            photon = np.broadcast_to(np.asarray(per_photon, np.float64), x.shape) / level
            moved = noise + photon * (np.maximum(white + expected, 0) - np.maximum(x, 0))
            noise = np.where(known, np.maximum(moved, photon**2 / 2), UNKNOWN)
        weights = np.asarray(query, np.float64)
        change, variance = self._explained(x - white, noise, weights)
        values, std = weights.sum(axis=1) + change, np.sqrt(variance)
        nothing = ~known.any(axis=-1, keepdims=True)
        return np.where(nothing, np.nan, values * level), np.where(nothing, np.nan, std * level)

    def _explained(
        self,
        off: NDArray[np.float64],
        noise: NDArray[np.float64],
        query: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute a query's difference from a level of 1.

        Each variance of the prior gives its own estimate; the evidence of the bands weighs them.

        Parameters
        ----------
        off : ndarray of float, shape (..., band)
            Measured reflectance less 1.
        noise : ndarray of float, shape (..., band)
            Variance of it.
        query : ndarray of float, shape (query, node)
            Weights on the spectrum at `NODES_NM`.

        Returns
        -------
        mean : ndarray of float, shape (..., query)
            The estimate.
        variance : ndarray of float, shape (..., query)
            Its variance.
        """
        answers, variances, evidence = [], [], []
        correlation = self.correlation
        for size in VARIANCES:
            prior = size * correlation + LEVEL_VARIANCE
            seen = self.shares @ prior
            gain = seen @ query.T  # (band, query)
            matrices = seen @ self.shares.T + noise[..., None] * np.eye(len(self.shares))
            right = np.concatenate(
                [off[..., None], np.broadcast_to(gain, (*off.shape, len(query)))], axis=-1
            )
            solved = np.linalg.solve(matrices, right)
            answers.append(np.einsum("bq,...b->...q", gain, solved[..., 0]))
            explained = np.einsum("bq,...bq->...q", gain, solved[..., 1:])
            variances.append(np.einsum("qn,nm,qm->q", query, prior, query) - explained)
            surprise = (off * solved[..., 0]).sum(axis=-1) + np.linalg.slogdet(matrices)[1]
            evidence.append(-surprise / 2)
        chance = np.exp(np.array(evidence) - np.max(evidence, axis=0))
        chance = (chance / chance.sum(axis=0))[..., None]
        mean = (chance * answers).sum(axis=0)
        spread = np.maximum(variances, 0) + (np.array(answers) - mean) ** 2
        return mean, (chance * spread).sum(axis=0)

    def to_xyz(self, *, illuminant: Illuminant = "D65") -> NDArray[np.float64]:
        """Make the query for `recover` that asks for CIE 1931 tristimulus values.

        Parameters
        ----------
        illuminant : {"D65", "C"}
            The light under which the surface is seen.

        Returns
        -------
        ndarray of float, shape (3, node)
            Weights for X, Y and Z; white has Y = 1.
        """
        return tristimulus(NODES_NM, illuminant=illuminant)
