# SPDX-License-Identifier: Apache-2.0
"""Tables of small whole numbers for sums of few bits, found by search.

With few bits, rounding costs more information than the number of sums does. Two things help. Tables
that are 0 but for the light of one band have small sums for entries of the same size, which scores
of the delay alone do not: so the search begins at one table for each band and a few for the delay.
And the entries of a code in all tables belong together: what rounding does to one sum can be taken
back by another. The search changes the entries of one code in one or two tables at a time, by one.

The gain of each change follows from the bound of each parameter, which is the least variance
w'Sw of all unbiased estimates w's of it (S: covariance of the sums): for a change e of the entries
of code i it is, to second order and with w held, -2 w'e r_i + μ_i (w'e)², r_i being the residual of
the estimate's score there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log2

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from hueflight.errors import HueflightError

Floats = NDArray[np.floating]

AMPLITUDE_WEIGHT = 0.1  #: of the loss of an amplitude against that of the delay
HEADROOM = 5.0  #: standard deviations of a sum above its greatest mean that its width holds
EXCESS_WEIGHT = 10.0  #: of the squared excess of a sum over its width, relative to this
ROUNDING = 1 / 12  #: variance of what rounding adds to an entry
SMOOTH_STEPS = 40  #: of the search before entries are whole
STEPS = 250  #: of the search after it
MOST_CHANGES = 256  #: of one step
TRIES = 120  #: of a step; the last ones change the entries of one code alone
MANY_TRIES = 12  #: that change the entries of several codes
LEAST_ENTRY = 0.7  #: that the greatest one of a table must reach
LEAST_ROOT = 0.15  #: of an entry at the beginning, below which it would not move
LEAST_GAIN = 1e-7
PATIENCE, PATIENT_GAIN = 20, 1e-3  #: steps in which the loss must fall by so much of it
FILLED = 0.98  #: of the room that the search may fill, since it holds only about


@dataclass(frozen=True, eq=False)
class Light:
    """Light that tables are made for.

    Attributes
    ----------
    means : ndarray of float, shape (condition, bin)
        Expected light of one photon.
    derivatives : ndarray of float, shape (condition, parameter, bin)
        Its derivatives by delay, amplitudes and background, which comes last.
    greatest : ndarray of float, shape (condition, bin)
        Expected light of one photon under which no sum may saturate.
    """

    means: Floats
    derivatives: Floats
    greatest: Floats


class TableSearch:
    """Search for tables of small whole numbers.

    Parameters
    ----------
    light : Light
        Light that the tables are made for.
    photons : float
        Photons of a pixel, of which no sum of `light` saturates; never more.
    widths : sequence of int
        Bits that there is room for, of each sum.
    most : int
        Greatest entry.
    """

    def __init__(self, light: Light, photons: float, widths: Sequence[int], most: int) -> None:
        self._light, self._photons, self._most = light, photons, most
        self._room = 2.0 ** np.array(widths) - 2
        whole = (light.derivatives / light.means[:, None]) @ np.swapaxes(light.derivatives, 1, 2)
        self._bounds = np.diagonal(np.linalg.inv(whole), axis1=1, axis2=2)[:, :-1]
        self._by_bin = np.ascontiguousarray(np.swapaxes(light.derivatives, 1, 2))

    def run(self, start: Floats, /) -> NDArray[np.uint16]:
        """Find tables.

        Parameters
        ----------
        start : ndarray of float, shape (sum, bin)
            Tables to begin with; the first one is 1 for each code and stays so. Others have any
            size, and no negative entry.

        Returns
        -------
        ndarray of uint16, shape (sum, bin)
            The best tables that were found.

        Raises
        ------
        HueflightError
            If a width holds no sum of so many photons.
        """
        rows = [start[0]]
        for row, room in zip(start[1:], self._room[1:], strict=True):
            scaled = row / row.max()
            scaled *= min(room / self.greatest_sums(scaled[None])[0], self._most)
            if scaled.max() < LEAST_ENTRY:
                raise HueflightError(
                    f"most_widths: {log2(room + 2):g} bits hold no sum of {self._photons:g} "
                    "photons; ask for more pictures per second"
                )
            rows.append(scaled)
        found = self._search(np.rint(self._smooth(np.array(rows))))
        return self._fitted(found).astype(np.uint16)

    def greatest_sums(self, entries: Floats, /) -> Floats:
        """Return what sums reach under the light that they must hold.

        Parameters
        ----------
        entries : ndarray of float, shape (sum, bin)
            The tables.

        Returns
        -------
        ndarray of float, shape (sum,)
            Mean and `HEADROOM` standard deviations. The photons are never more than stated, so that
            a table of ones varies not at all.
        """
        return self._reached(entries)[0].max(axis=0)

    def _reached(self, entries: Floats) -> tuple[Floats, Floats, Floats]:
        """Sums that are reached under each condition; mean and deviation of one photon's entry."""
        mean = self._light.greatest @ entries.T
        spread = np.sqrt(np.maximum(self._light.greatest @ (entries**2).T - mean**2, 1e-9))
        photons = self._photons
        return photons * mean + HEADROOM * np.sqrt(photons) * spread, mean, spread

    def _fitted(self, entries: Floats) -> Floats:
        """Tables whose sums fit: entries are lowered where that harms least."""
        while True:
            over = np.flatnonzero((self.greatest_sums(entries) > self._room)[1:]) + 1
            if not over.size:
                return entries
            _, slope, curvature = self._derivatives(entries)
            light = self._light.greatest.max(axis=0)
            for number in over:
                harm = (curvature[:, number * (len(entries) + 1)] - slope[number]) / light
                harm[entries[number] <= 0] = np.inf
                entries[number, harm.argmin()] -= 1

    # -- the loss -----------------------------------------------------------------------------

    def _excess(self, entries: Floats) -> tuple[float, Floats]:
        """Penalty for sums that do not fit, and its derivatives."""
        reached, mean, spread = self._reached(entries)
        worst, each = reached.argmax(axis=0), np.arange(len(entries))
        over = np.maximum(reached[worst, each] / (FILLED * self._room) - 1, 0.0)
        over[0] = 0.0
        light, root = self._light.greatest[worst], HEADROOM * np.sqrt(self._photons)
        slope = self._photons * light + (root / spread[worst, each])[:, None] * light * (
            entries - mean[worst, each][:, None]
        )
        return EXCESS_WEIGHT * float(over @ over), (
            2 * EXCESS_WEIGHT * (over / self._room)[:, None] * slope
        )

    def _estimates(self, entries: Floats, noise: float) -> tuple[Floats, Floats, Floats]:
        """Best estimates of all parameters, their covariance, variances against the bounds."""
        means = entries @ self._by_bin
        covariance = (entries * self._light.means[:, None]) @ entries.T
        if noise:
            covariance[:, np.arange(1, len(entries)), np.arange(1, len(entries))] += noise
        weights = np.linalg.solve(covariance, means)
        inverse = np.linalg.inv(np.swapaxes(means, 1, 2) @ weights)
        variance = np.diagonal(inverse, axis1=1, axis2=2)[:, :-1]
        return weights @ inverse[:, :, :-1], inverse[:, :, :-1], variance / self._bounds

    def _loss_of(self, ratio: Floats) -> float:
        """Squares, so that the worst conditions count most."""
        return float(
            (ratio[:, 0] ** 2).mean() + AMPLITUDE_WEIGHT * (ratio[:, 1:] ** 2).sum(axis=1).mean()
        )

    def _loss(self, entries: Floats) -> float:
        return self._loss_of(self._estimates(entries, 0.0)[2]) + self._excess(entries)[0]

    def _derivatives(self, entries: Floats, noise: float = 0.0) -> tuple[float, Floats, Floats]:
        """Loss, its derivatives, and second derivatives (bin, sum · sum) by entries of one bin."""
        estimates, inverse, ratio = self._estimates(entries, noise)
        importance = 2 * ratio / self._bounds / len(ratio)
        importance[:, 1:] *= AMPLITUDE_WEIGHT
        weighted = estimates * importance[:, None]
        residual = self._by_bin @ inverse
        residual -= self._light.means[:, :, None] * (entries.T @ estimates)
        slope = -2 * np.tensordot(weighted, residual, axes=((0, 2), (0, 2)))
        curvature = (weighted @ np.swapaxes(estimates, 1, 2)).reshape(len(ratio), -1)
        penalty, penalty_slope = self._excess(entries)
        return (
            self._loss_of(ratio) + penalty,
            slope + penalty_slope,
            self._light.means.T @ curvature,
        )

    # -- the search ---------------------------------------------------------------------------

    def _smooth(self, start: Floats) -> Floats:
        """Tables of any numbers that rounding harms little."""

        def loss(roots: Floats) -> tuple[float, Floats]:
            each = roots.reshape(len(start) - 1, -1)
            value, slope, _ = self._derivatives(np.vstack([start[:1], each**2]), ROUNDING)
            return value, (2 * each * slope[1:]).ravel()

        most = np.sqrt(self._most)
        roots = np.clip(np.sqrt(start[1:]), LEAST_ROOT, most).ravel()
        found = minimize(
            loss, roots, jac=True, method="L-BFGS-B", bounds=[(0, most)] * roots.size,
            options={"maxiter": SMOOTH_STEPS, "maxcor": 20},
        )  # fmt: skip
        return np.vstack([start[:1], found.x.reshape(len(start) - 1, -1) ** 2])

    def _search(self, entries: Floats) -> Floats:
        """Change entries as long as that helps."""
        rng, changes = np.random.default_rng(1), _changes(len(entries))
        pairs = (changes[:, :, None] * changes[:, None, :]).reshape(len(changes), -1)
        lower = [np.flatnonzero(changes[:, number] < 0) for number in range(len(entries))]
        raised = [np.flatnonzero(changes[:, number] > 0) for number in range(len(entries))]
        loss, many = self._loss(entries), MOST_CHANGES / 2
        before = loss
        for step in range(STEPS):
            if step and not step % PATIENCE:
                if loss > (1 - PATIENT_GAIN) * before:
                    return entries
                before = loss
            _, slope, curvature = self._derivatives(entries)
            gain = changes @ slope + pairs @ curvature.T
            for number, row in enumerate(entries):
                gain[np.ix_(lower[number], row <= 0)] = np.inf
                gain[np.ix_(raised[number], row >= self._most)] = np.inf
            best = gain.argmin(axis=0)
            order = np.argsort(gain[best, np.arange(best.size)])
            order = order[gain[best[order], order] < 0]
            for attempt in range(TRIES):
                if not order.size:
                    return entries
                many = min(many, order.size) if attempt < MANY_TRIES else 1
                some = order[: int(many)]
                if attempt % 2:
                    among = order[: max(4 * some.size, MANY_TRIES + attempt)]
                    some = rng.choice(among, min(some.size, among.size), replace=False)
                elif attempt >= MANY_TRIES:
                    some = order[attempt - MANY_TRIES :][:1]
                changed = entries.copy()
                changed[:, some] += changes[best[some]].T
                value = self._loss(changed)
                if value < loss - LEAST_GAIN:
                    entries, loss, many = changed, value, min(1.5 * many + 1, MOST_CHANGES)
                    break
                many = max(many / 1.6, 1)
            else:
                return entries
        return entries


def _changes(sums: int) -> Floats:
    """Changes of one or two entries by one, (change, sum); never of the first."""
    one = np.vstack([np.eye(sums)[1:], -np.eye(sums)[1:]])
    first, second = np.triu_indices(len(one), 1)
    two = one[first] + one[second]
    return np.vstack([one, two[np.abs(two).sum(axis=1) == 2]])
