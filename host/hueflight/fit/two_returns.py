# SPDX-License-Identifier: Apache-2.0
"""Fit of two surfaces in one pixel, as of a pane of glass in front of a wall.

The likelihood of two delays, each with an amplitude of every band, has many maxima: pulses of one
surface pass for those of another band of the other surface. It is therefore looked at on all pairs
of a grid of delays, with amplitudes by expectation maximisation; every local maximum that is
among the best is refined by scoring. The choice between the refined pairs takes into account that
spectra of surfaces are smooth, which the likelihood alone does not know. Delays and amplitudes of
the chosen pair are those of maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.surfaces import (
    ScoredSurfaces,
    Surfaces,
    dense_rows,
    polish_amplitudes,
    score_surfaces,
)
from hueflight.fit.tables import ModelTables

LEAST_STEPS = 2  #: of the grid between the delays of a pair
SEARCH_ROUNDS = 3  #: of expectation maximisation for each pair
ACCELERATED = 1.5  #: exponent of its factors but in the last round
CANDIDATES = 10  #: pairs that are refined
WIDE_STEPS, FINE_STEPS = 5, 3  #: of scoring
START_BACKGROUND = 0.2  #: share of the counts
ROUGHNESS = 0.5  #: typical change of a reflectance's logarithm from band to band
CHUNK = 64  #: pixels that are fitted together, which bounds the memory it takes,
CHUNK_PIXELS = 16  #: and of which all pairs are looked at together

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TwoReturns:
    """Result of the fit of two surfaces, the nearer one first.

    Attributes
    ----------
    delay_ns, delay_std_ns : ndarray of float, shape (pixel, 2)
        Arrival against the templates, and its standard deviation.
    amplitudes, amplitude_std : ndarray of float, shape (pixel, 2, band)
        Photons of each band from each surface, and their standard deviations.
    inflation : ndarray of float, shape (pixel, 2, band)
        Variance of the amplitude over what it would be if all other parameters were known.
    influence : ndarray of float, shape (pixel, 2, band)
        Change of the delay by that of a band's pulse.
    background : ndarray of float, shape (pixel,)
        Photons over all bins.
    log_likelihood : ndarray of float, shape (pixel,)
        At the wide bins, but for a constant that the counts determine.
    chi_square : ndarray of float, shape (pixel,)
        Pearson's χ² at the wide bins per degree of freedom.
    chi_square_shape : ndarray of float, shape (pixel,)
        Shape of the gamma distribution that `chi_square` has if two surfaces are all there is.
    """

    delay_ns: _Floats
    delay_std_ns: _Floats
    amplitudes: _Floats
    amplitude_std: _Floats
    inflation: _Floats
    influence: _Floats
    background: _Floats
    log_likelihood: _Floats
    chi_square: _Floats
    chi_square_shape: _Floats

    def take(self, chosen: NDArray[Any]) -> TwoReturns:
        """Return the fit of some of the pixels.

        Parameters
        ----------
        chosen : ndarray
            Pixels to take.

        Returns
        -------
        TwoReturns
            Their fit.
        """
        return TwoReturns(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    @staticmethod
    def joined(parts: Sequence[TwoReturns]) -> TwoReturns:
        """Return the fits of several sets of pixels as one.

        Parameters
        ----------
        parts : sequence of TwoReturns
            The fits, at least one.

        Returns
        -------
        TwoReturns
            All pixels, one set after the other.
        """
        names = TwoReturns.__dataclass_fields__
        return TwoReturns(
            *(np.concatenate([getattr(one, name) for one in parts]) for name in names)
        )


def fit_two_returns(
    light: NDArray[np.floating],
    offsets_ns: _Floats,
    tables: ModelTables,
    brightness: NDArray[np.floating],
) -> TwoReturns:
    """Fit two surfaces to every pixel.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order, at least one count in each pixel.
    offsets_ns : ndarray of float, shape (pixel,)
        Delay that belongs to the pixel, not to the scene.
    tables : ModelTables
        Tables of the fit.
    brightness : ndarray of float, shape (band,)
        Photons of a white target, on any scale.

    Returns
    -------
    TwoReturns
        Result for each pixel, whether or not it sees two surfaces.
    """
    white = np.asarray(brightness, np.float64) / np.sum(brightness)
    parts = [
        _fit_chunk(light[first : first + CHUNK], offsets_ns[first : first + CHUNK], tables, white)
        for first in range(0, max(len(light), 1), CHUNK)
    ]
    return TwoReturns.joined(parts)


def fit_from_pairs(
    light: NDArray[np.floating], offsets_ns: _Floats, tables: ModelTables, start: Surfaces
) -> TwoReturns:
    """Fit two surfaces whose delays and amplitudes are nearly known.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order, at least one count in each pixel.
    offsets_ns : ndarray of float, shape (pixel,)
        Delay that belongs to the pixel, not to the scene.
    tables : ModelTables
        Tables of the fit.
    start : Surfaces
        Two surfaces for each pixel.

    Returns
    -------
    TwoReturns
        Result for each pixel.
    """
    pixels = _Pixels.of(light, offsets_ns, tables)
    coarse = pixels.scored_coarsely(start)
    polished, likelihood, _ = polish_amplitudes(pixels.wide, coarse.state, tables.wide)
    return pixels.refined(coarse, polished, likelihood)


def _fit_chunk(
    light: NDArray[np.floating], offsets_ns: _Floats, tables: ModelTables, white: _Floats
) -> TwoReturns:
    """Fit two surfaces to a few pixels."""
    pixels = _Pixels.of(light, offsets_ns, tables)
    number, pairs = _candidates(pixels.wide, tables, white)
    coarse = pixels.take(number).scored_coarsely(pairs)
    polished, likelihood, _ = polish_amplitudes(pixels.wide[number], coarse.state, tables.wide)
    variances = coarse.variances[:, :-3].reshape(polished.amplitudes.shape)
    score = likelihood - _roughness(polished.amplitudes, variances, white)
    chosen = _best(score, number, len(light))
    return pixels.refined(coarse.take(chosen), polished.take(chosen), likelihood[chosen])


@dataclass(frozen=True)
class _Pixels:
    """Counts at the fine and the wide bins (pixel, bin), and what belongs to each pixel."""

    fine: _Floats
    wide: _Floats
    offsets_ns: _Floats
    tables: ModelTables

    @staticmethod
    def of(light: NDArray[np.floating], offsets_ns: _Floats, tables: ModelTables) -> _Pixels:
        fine = tables.fine.summed(np.asarray(light, np.float64))
        return _Pixels(fine, tables.search.summed(fine), offsets_ns, tables)

    def take(self, chosen: NDArray[np.intp]) -> _Pixels:
        return _Pixels(self.fine[chosen], self.wide[chosen], self.offsets_ns[chosen], self.tables)

    def bounds(self) -> tuple[_Floats, _Floats]:
        """Least and greatest delay (pixel, 1)."""
        low, high = ((self.offsets_ns + bound)[:, None] for bound in self.tables.search_ns)
        return low, high

    def scored_coarsely(self, pairs: Surfaces) -> ScoredSurfaces:
        """Pairs, one for each pixel, after scoring at the wide bins."""
        return score_surfaces(self.wide, pairs, self.tables.wide, *self.bounds(), WIDE_STEPS)

    def refined(
        self, coarse: ScoredSurfaces, polished: Surfaces, likelihood: _Floats
    ) -> TwoReturns:
        """Pairs after scoring at the fine bins."""
        tables, wide = self.tables, self.wide
        scored = score_surfaces(self.fine, polished, tables.fine, *self.bounds(), FINE_STEPS)
        after = polish_amplitudes(wide, scored.state, tables.wide)[1]
        # where pulses of both surfaces coincide, scoring may leave the maximum
        scored = scored.where(after > likelihood - 1, coarse)
        _, likelihood, mean = polish_amplitudes(wide, scored.state, tables.wide)
        freedom = max(wide.shape[-1] - 2 * tables.bands - 3, 1)
        state, variances = scored.state, scored.variances
        order = np.argsort(state.delays, axis=1)

        def ordered(values: _Floats) -> _Floats:
            return np.take_along_axis(
                values, order.reshape(order.shape + (1,) * (values.ndim - 2)), 1
            )

        def by_band(values: _Floats) -> _Floats:
            return ordered(values[:, :-3].reshape(state.amplitudes.shape))

        return TwoReturns(
            delay_ns=ordered(state.delays - self.offsets_ns[:, None]),
            delay_std_ns=ordered(np.sqrt(variances[:, -2:])),
            amplitudes=ordered(state.amplitudes),
            # a count's posterior is half a photon wider than the count (Jeffreys' prior)
            amplitude_std=np.sqrt(by_band(variances) + 0.5),
            inflation=by_band(variances * scored.information),
            influence=ordered(scored.influence),
            background=state.background,
            log_likelihood=likelihood,
            chi_square=((wide - mean) ** 2 / mean).sum(axis=-1) / freedom,
            # as in `assessment`: few expected counts widen the distribution
            chi_square_shape=freedom**2 / (2 * freedom + (1 / mean).sum(axis=-1)),
        )


def one_surface_likelihood(
    light: NDArray[np.floating],
    arrival_ns: _Floats,
    amplitudes: _Floats,
    background: _Floats,
    tables: ModelTables,
) -> _Floats:
    """Log-likelihood of one surface, comparable with that of two.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order.
    arrival_ns : ndarray of float, shape (pixel,)
        Delay of the surface, that of the pixel itself included, ns.
    amplitudes : ndarray of float, shape (pixel, band)
        Photons of each band.
    background : ndarray of float, shape (pixel,)
        Photons over all bins.
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    ndarray of float, shape (pixel,)
        The log-likelihood, but for a constant that the counts determine.
    """
    wide = tables.wide_counts(light)
    state = Surfaces(arrival_ns[:, None], amplitudes[:, None], background)
    return polish_amplitudes(wide, state, tables.wide)[1]


def best_single(
    light: NDArray[np.floating], tables: ModelTables, brightness: NDArray[np.floating]
) -> tuple[_Floats, _Floats]:
    """Find the best delay of one surface on the grid of the search.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order.
    tables : ModelTables
        Tables of the fit.
    brightness : ndarray of float, shape (band,)
        Photons of a white target, on any scale.

    Returns
    -------
    arrival_ns : ndarray of float, shape (pixel,)
        Delay of the surface, that of the pixel itself included, ns.
    amplitudes : ndarray of float, shape (pixel, band)
        Photons of each band.
    """
    wide = tables.wide_counts(light)
    white = np.asarray(brightness, np.float64) / np.sum(brightness)
    photons = wide.sum(axis=-1) * (1 - START_BACKGROUND)
    start = photons[:, None, None] * white
    best = np.full(len(wide), -np.inf)
    arrival, amplitudes = np.zeros(len(wide)), start[:, 0].copy()
    for delay in tables.search.lags_ns:
        state = Surfaces(np.full((len(wide), 1), delay), start, wide.sum(axis=-1) - photons)
        state, likelihood, _ = polish_amplitudes(wide, state, tables.wide)
        better = likelihood > best
        best[better], arrival[better] = likelihood[better], delay
        amplitudes[better] = state.amplitudes[better, 0]
    return arrival, amplitudes


def _candidates(
    wide: _Floats, tables: ModelTables, white: _Floats
) -> tuple[NDArray[np.intp], Surfaces]:
    """Pixels and pairs to refine: the best local maxima of the likelihood over the grid."""
    level, grid = tables.wide, tables.search.lags_ns
    shares = dense_rows(level.phase_of(grid), level, level.tiles.shares)
    near, far = np.triu_indices(grid.size, LEAST_STEPS)
    flat = np.broadcast_to(level.widths, (near.size, 1, level.widths.size))
    linear = np.concatenate([shares[near], shares[far], flat], axis=1)
    turned = np.ascontiguousarray(linear.transpose(0, 2, 1))
    whole = np.maximum(linear.sum(axis=-1), 1e-3)[:, None]
    start = np.concatenate([white, white, [0]]) * (1 - START_BACKGROUND) / 2
    start[-1] = START_BACKGROUND
    pixels, chosen, thetas = [], [], []
    for first in range(0, len(wide), CHUNK_PIXELS):
        h = wide[first : first + CHUNK_PIXELS].astype(np.float32)
        theta = (h.sum(axis=-1)[None, :, None] * start).astype(np.float32)
        for number in range(SEARCH_ROUNDS):
            factor = np.matmul(h / np.matmul(theta, linear), turned) / whole
            theta = theta * (factor if number == SEARCH_ROUNDS - 1 else factor**ACCELERATED)
        mean = np.matmul(theta, linear)
        likelihood = (h * np.log(mean)).sum(axis=-1) - mean.sum(axis=-1)  # pair, pixel
        surfaces = theta[..., :-1].reshape(*theta.shape[:-1], 2, -1).astype(np.float64)
        score = likelihood - _roughness(surfaces, surfaces, white)
        pixel, pair = _peaks(score, near, far, grid.size)
        pixels.append(pixel + first)
        chosen.append(pair)
        thetas.append(theta[pair, pixel].astype(np.float64))
    theta, pair = np.concatenate(thetas), np.concatenate(chosen)
    amplitudes = theta[:, :-1].reshape(len(theta), 2, -1)
    delays = np.stack([grid[near[pair]], grid[far[pair]]], axis=1)
    return np.concatenate(pixels), Surfaces(delays, amplitudes, theta[:, -1])


def _peaks(
    score: _Floats, near: NDArray[np.intp], far: NDArray[np.intp], size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pixels and pairs of the best local maxima of scores (pair, pixel), pixels in order."""
    plane = np.full((size + 2, size + 2, score.shape[1]), -np.inf)
    plane[near + 1, far + 1] = score
    around = np.full_like(score, -np.inf)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                np.maximum(around, plane[near + 1 + down, far + 1 + right], out=around)
    peaks = np.where(score >= around, score, -np.inf)
    most = min(CANDIDATES, len(peaks))
    best = np.argpartition(-peaks, most - 1, axis=0)[:most]
    pixel = np.broadcast_to(np.arange(score.shape[1]), best.shape)
    is_peak = np.isfinite(np.take_along_axis(peaks, best, axis=0))
    return pixel.T[is_peak.T], best.T[is_peak.T]


def _roughness(amplitudes: _Floats, variances: _Floats, white: _Floats) -> _Floats:
    """How unlikely spectra are, as a log-likelihood; amplitudes (..., surface, band)."""
    # a band that is not known is as bright as its noise allows
    noise = np.sqrt(np.maximum(variances, 0.0) + 0.5)
    counts = np.maximum(amplitudes, 0.0) + noise
    steps = np.diff(np.log(counts / white), axis=-1)
    relative = (noise / counts) ** 2
    variance = ROUGHNESS**2 + relative[..., 1:] + relative[..., :-1]
    return 0.5 * (steps**2 / variance).sum(axis=(-1, -2))


def _best(score: _Floats, pixel: NDArray[np.intp], pixels: int) -> NDArray[np.intp]:
    """Number of each pixel's candidate with the highest score."""
    order = np.lexsort((score, pixel))
    last = np.searchsorted(pixel[order], np.arange(pixels), side="right") - 1
    return order[last]
