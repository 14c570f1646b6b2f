# SPDX-License-Identifier: Apache-2.0
"""Delay, amplitudes and background from sums: the definition of the estimator.

Quasi-likelihood (Wedderburn, Biometrika 61, 1974): the mean of the sums is fitted under their own
covariance, which follows from the fitted light as in a Poisson likelihood. No estimate that is
linear in the counts around the truth does better with the same sums.

1. *Search*: at each lag, how far sums lie from any light at that lag, under the covariance of a
   white surface. A parabola through the best lag and its neighbors gives the delay.
2. *Separation* at the tabulated delay next to it: one matrix makes the sums to photons of each band
   and of the background, as estimated under the covariance of a white surface, and to a few others,
   the *rest*, which are 0 on average whatever the light. Tables give the covariance of all these
   for the light that was found.
3. *Solution*: only the delay changes the mean of the rest, by which it is estimated. The noise of
   the rest then tells what photons have in common with it, which is taken from them. This is
   weighted least squares for delay, amplitudes and background together, with a matrix of the size
   of the rest instead of that of the sums to invert.

Everything here works on many pixels at once; `hueflight/reconstruction/sums/_c` holds the same in
C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.reconstruction.sums.delay_tables import (
    LAG_PHASES,
    SumTables,
    unpack_covariance,
)

FLOOR_SHARE = 0.02  #: background in the weights, at least, as a share of all photons
FLOOR_PHOTONS = 2.0  #: and so many photons
RIDGE = 1e-6  #: on the diagonal of the covariance of the rest, relative to it
LEAST_INFORMATION = 1e-20  #: about the delay, where there is none
BLOCK = 4096  #: pixels at a time

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SumsFit:
    """Result of the estimator for each pixel.

    Attributes
    ----------
    delay_ns, delay_std_ns : ndarray of float, shape (pixel,)
        Delay against the middle of the design, and its standard deviation.
    amplitudes, amplitude_std : ndarray of float, shape (pixel, band)
        Photons of each band, and their standard deviation.
    background : ndarray of float, shape (pixel,)
        Photons over all bins.
    distance : ndarray of float, shape (pixel,)
        Squared distance of the sums from the fitted ones under their covariance: χ² with as many
        degrees of freedom as there are sums less the bands and 2.
    dark_distance : ndarray of float, shape (pixel,)
        The same for background alone: as many degrees of freedom as there are sums less 1.
    """

    delay_ns: Floats
    delay_std_ns: Floats
    amplitudes: Floats
    amplitude_std: Floats
    background: Floats
    distance: Floats
    dark_distance: Floats

    @classmethod
    def empty(cls, pixels: int, bands: int) -> SumsFit:
        """Make room for results.

        Parameters
        ----------
        pixels, bands : int
            Their numbers.

        Returns
        -------
        SumsFit
            Arrays that are not filled yet.
        """
        lines = [np.empty(pixels) for _ in range(5)]
        planes = [np.empty((pixels, bands)) for _ in range(2)]
        return cls(lines[0], lines[1], planes[0], planes[1], *lines[2:])


def estimate_reference(sums: Floats, number: NDArray[np.intp], tables: SumTables) -> SumsFit:
    """Estimate delay, amplitudes and background of every pixel, in NumPy.

    Parameters
    ----------
    sums : ndarray of float, shape (pixel, sum)
        Sums; the first is the number of photons, above 0.
    number : ndarray of int, shape (pixel,)
        Place of each pixel's offset in the tables.
    tables : SumTables
        Tables of the estimator.

    Returns
    -------
    SumsFit
        Results.
    """
    found = SumsFit.empty(len(sums), tables.bands)
    for start in range(0, len(sums), BLOCK):
        here = slice(start, start + BLOCK)
        seen, n, photons = sums[here] @ tables.whiten.T, number[here], sums[here, 0]
        rest = seen - photons[:, None] * tables.dark[n]
        found.dark_distance[here] = ((rest @ tables.dark_test.T) ** 2).sum(axis=1) / photons
        phase = tables.phase_of(search(seen, tables))
        photons_and_rest = np.einsum("pij,pj->pi", tables.separate[n, phase], seen)
        solution = _solve(photons_and_rest, photons, n, phase, tables)
        delay_ns = tables.first_ns + phase * tables.phase_ns + solution.moved_ns
        found.delay_ns[here] = np.clip(delay_ns, tables.first_ns, tables.last_ns)
        found.delay_std_ns[here] = solution.delay_std_ns
        found.amplitudes[here] = solution.light[:, :-1]
        found.amplitude_std[here] = solution.deviations[:, :-1]
        found.background[here] = solution.light[:, -1]
        found.distance[here] = solution.distance
    return found


def search(sums: Floats, tables: SumTables) -> Floats:
    """Find the delay at which sums are separated.

    Parameters
    ----------
    sums : ndarray of float, shape (pixel, sum)
        Whitened sums.
    tables : SumTables
        Tables of the estimator.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Delays.
    """
    distances = np.stack(
        [((sums @ null.T) ** 2).sum(axis=-1) for null in tables.nulls], axis=-1
    )  # a few matrix products are faster than one of three dimensions
    best = distances.argmin(axis=-1)
    inner = np.clip(best, 1, tables.lags - 2)
    each = np.arange(len(sums))
    left, middle, right = (distances[each, inner + shift] for shift in (-1, 0, 1))
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / np.where(bend > 0, bend, np.inf)
    shift = np.where(best == inner, np.clip(shift, -0.5, 0.5), best - inner)
    lag_ns = tables.phase_ns * LAG_PHASES
    return tables.first_ns + (inner + shift) * lag_ns


@dataclass(frozen=True)
class _Solution:
    moved_ns: Floats
    delay_std_ns: Floats
    light: Floats
    deviations: Floats
    distance: Floats


def _solve(
    photons_and_rest: Floats,
    photons: Floats,
    number: NDArray[np.intp],
    phase: NDArray[np.intp],
    tables: SumTables,
) -> _Solution:
    """Weighted least squares of photons and rest at tabulated delays."""
    each = tables.bands + 1
    light, rest = photons_and_rest[:, :each], photons_and_rest[:, each:]
    weights = np.maximum(light, 0.0)
    weights[:, -1] = np.maximum(weights[:, -1], FLOOR_SHARE * photons + FLOOR_PHOTONS)
    slope = np.einsum("pb,pbk->pk", weights[:, :-1], tables.slopes[number, phase])
    packed = np.einsum("pb,pbe->pe", weights, tables.covariances[phase])
    variance, common, own = unpack_covariance(packed, each, tables.rest)
    diagonal = np.arange(tables.rest)
    own[:, diagonal, diagonal] *= 1 + RIDGE
    lower = np.linalg.cholesky(own)
    white = np.concatenate([rest[..., None], slope[:, each:, None], common], axis=2)
    white = np.linalg.solve(lower, white)
    seen, change, common = white[:, :, 0], white[:, :, 1], white[:, :, 2:]
    certainty = 1 / np.maximum((change**2).sum(axis=1), LEAST_INFORMATION)
    moved_ns = (seen * change).sum(axis=1) * certainty
    left = seen - change * moved_ns[:, None]
    by_delay = slope[:, :each] - np.einsum("prk,pr->pk", common, change)
    own_variance = np.maximum(variance - (common**2).sum(axis=1), 0.0)
    return _Solution(
        moved_ns=moved_ns,
        delay_std_ns=np.sqrt(certainty),
        light=light - slope[:, :each] * moved_ns[:, None] - np.einsum("prk,pr->pk", common, left),
        deviations=np.sqrt(own_variance + by_delay**2 * certainty[:, None]),
        distance=(left**2).sum(axis=1),
    )
