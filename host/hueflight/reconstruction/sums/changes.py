# SPDX-License-Identifier: Apache-2.0
"""Tell where a scene has changed from sums: the newest ones against all those before them.

A contrast is a combination of sums, and so the sum over all photons of a function v of their code.
Its variance is the sum of v² over the photons, which the sums do not tell. A combination of sums
whose function is nowhere below v² tells a bound of it, whatever the light is: of all of these,
linear programming finds the one that is the least on average over the codes. So chance is not taken
for a change more often than stated, at the price of larger deviations.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from hueflight.calibration import Calibration
from hueflight.ingest.scene_change import BRIGHTNESS_TOLERANCE, SHIFT_TOLERANCE, SIGMA
from hueflight.reconstruction.sums.design import MORE_SUMS
from hueflight_protocol.reduction import ReductionTables

GROUP_CODES = 4  #: in whose groups `SHIFT_TOLERANCE` counts
MANY_PHOTONS = 1e12  #: of which no change is chance
SHIFT_STEP_NS, SHIFT_STEPS, SHIFT_STARTS = 0.02, 60, 7  #: shifts and delays that are tried


class SumsContrasts:
    """Contrasts between sums: all photons, and as many more as there are other sums.

    The functions are orthonormal over the codes; the first is 1.

    Parameters
    ----------
    entries : array, shape (sum, code)
        Tables, without the codes that stand for no time; the first one counts photons.

    Attributes
    ----------
    functions : array of float, shape (contrast, code)
        Function of each contrast.
    bounds : array of float, shape (contrast, code)
        Function whose sum over photons is a bound of the contrast's variance.
    """

    def __init__(self, entries: NDArray[np.integer], /) -> None:
        tables = entries.astype(np.float64)
        codes = tables.shape[1]
        triangle: NDArray[np.float64] = np.asarray(
            np.linalg.qr(tables.T / np.sqrt(codes), mode="r")  # one array in this mode
        )
        steps = np.diag_indices(len(tables))
        dependent = np.abs(triangle[steps]) < 1e-9 * np.abs(triangle).max()
        triangle[steps] = np.where(dependent, np.inf, triangle[steps])  # tells nothing new: 0
        of_sums = np.linalg.inv(triangle).T
        self._contrasts = of_sums * np.sign(of_sums[0, 0])
        self.functions = self._contrasts @ tables
        self._variances = np.array([_bound(tables, each**2) for each in self.functions])
        self.bounds = self._variances @ tables
        self._bands = max(1, len(tables) - MORE_SUMS)
        self._most = np.abs(self.functions).max(axis=1)
        slopes = np.diff(self.functions, axis=1)
        self._shift = SHIFT_TOLERANCE * GROUP_CODES * np.sqrt((slopes**2).mean(axis=1))

    @classmethod
    @lru_cache(maxsize=4)
    def of(cls, tables: ReductionTables, /) -> SumsContrasts:
        """Return the contrasts of tables, which take about a second to find.

        Parameters
        ----------
        tables : ReductionTables
            Tables of the sums.

        Returns
        -------
        SumsContrasts
            Their contrasts.
        """
        return cls(tables.entries[:, tables.first : tables.last + 1])

    def compare(
        self,
        newest: NDArray[np.float64],
        earlier: NDArray[np.float64],
        ratio: NDArray[np.float64],
        size: int,
        /,
    ) -> NDArray[np.float64]:
        """Return the significance of changes, for `changed_tiles`.

        By Bernstein's inequality, which also holds where photons are few, a contrast of known
        variance reaches s standard deviations by chance with a probability of at most
        2 exp(-s²/2).

        Parameters
        ----------
        newest, earlier : array of float, shape (tile row, tile col, sum)
            Sums.
        ratio : array of float, shape (tile row, tile col)
            Frames of `newest` per frame of `earlier`; 0 leaves a tile out.
        size : int
            Tiles on a side of each square that is compared.

        Returns
        -------
        array of float, shape (square row, square col)
            Standard deviations of the contrast that differs most, beyond what is tolerated.
        """
        compared = (ratio > 0)[..., None]
        scale = ratio[..., None]
        seen, expected = _of_squares(newest * compared, size), _of_squares(earlier * scale, size)
        of_chance = _of_squares((newest + earlier) * scale, size)
        difference = np.abs((seen - expected) @ self._contrasts.T)
        variance = np.maximum(of_chance @ self._variances.T, 0.0)
        photons = expected[..., :1]
        power = np.maximum(expected @ self._variances.T, 0.0)
        # what changes of all light, changes of each band by itself, and a shift may bring about
        bands = np.sqrt(photons * power / self._bands)
        tolerated = BRIGHTNESS_TOLERANCE * (np.abs(expected @ self._contrasts.T) + bands)
        tolerated += self._shift * photons
        beyond = np.maximum(difference - tolerated, 0.0)
        most = np.maximum(_of_squares(ratio, size, np.maximum), 1.0)
        jump = most[..., None] * self._most  # of a single photon
        spread = variance + jump * beyond / 3
        found = np.divide(beyond**2, spread, out=np.zeros(spread.shape), where=spread > 0)
        return np.sqrt(found.max(axis=-1))


@lru_cache(maxsize=4)
def unnoticed_shift_ns(
    calibration: Calibration, tables: ReductionTables, middle_ns: float, reach_ns: float, /
) -> float:
    """Return by how much the delay of a white surface can change without being told from drift.

    Parameters
    ----------
    calibration : Calibration
        Calibration that the tables were designed from.
    tables : ReductionTables
        Tables of the sums.
    middle_ns, reach_ns : float
        Delays that the tables are for, as `SumsDesign` has them.

    Returns
    -------
    float
        Greatest such change, ns, between two delays that the tables are for, of any number of
        photons.
    """
    contrasts, bins = SumsContrasts.of(tables), calibration.bins
    entries = tables.entries[:, bins.codes].astype(np.float64)
    white = calibration.brightness / calibration.brightness.sum()
    shifts_ns = np.append(0.0, np.geomspace(SHIFT_STEP_NS, 2 * reach_ns, SHIFT_STEPS))
    worst = 0.0
    for start_ns in np.linspace(-reach_ns, reach_ns, SHIFT_STARTS):
        for sign in (-1.0, 1.0):
            delays_ns = start_ns + sign * shifts_ns
            delays_ns = middle_ns + delays_ns[np.abs(delays_ns) <= reach_ns]
            shares = calibration.templates.shares(bins.edges_ns, delays_ns[:, None])
            sums = MANY_PHOTONS * (np.tensordot(white, shares, 1) @ entries.T)[:, None]
            before = np.broadcast_to(sums[:1], sums.shape)
            found = contrasts.compare(sums, before, np.ones(sums.shape[:2]), 1).ravel() > SIGMA
            last = int(np.flatnonzero(~found)[-1])  # none is noticed without a shift
            worst = max(worst, float(shifts_ns[min(last + 1, found.size - 1)]))
    return worst


def _bound(tables: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """The combination of tables that is nowhere below what is wanted and least on average."""
    found = linprog(
        tables.mean(axis=1), A_ub=-tables.T, b_ub=-wanted, bounds=(None, None), method="highs"
    )
    combined = np.asarray(found.x, np.float64)
    combined[0] += max(0.0, float((wanted - combined @ tables).max()))  # what rounding has left
    return combined


def _of_squares(
    tiles: NDArray[np.float64], size: int, joined: np.ufunc = np.add
) -> NDArray[np.float64]:
    """Sums, or another reduction, over squares of so many tiles on a side."""
    rows, cols = tiles.shape[:2]
    down = joined.reduceat(tiles, np.arange(0, rows, size), axis=0)
    return np.asarray(joined.reduceat(down, np.arange(0, cols, size), axis=1))
