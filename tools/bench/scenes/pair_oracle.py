# SPDX-License-Identifier: Apache-2.0
"""Two surfaces in a pixel by exhaustive search with the true pulses: what any fit could find.

It shares no code with the project. Every pair of delays of a grid is tried, with amplitudes of all
bands that are not negative and a background; around the best pairs, finer grids follow. Unlike the
project, it knows the pulses as they are and has no limit of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from outside_model import PERIOD_NS, band_shares, edges_ns

STEP_M = 0.16  #: of the first grid of depths
FINER_M = (0.06, 0.02)  #: of the grids around the best pairs, with two steps to either side
BIN_NS = 2 * 0.642  #: of the counts in the search; pulses are 7 ns wide and more
GRID_ROUNDS, FINAL_ROUNDS = 12, 60  #: of expectation maximization
BEST = 5  #: pairs that are refined
LEAST_APART_M = 0.3  #: between the surfaces of a pair
START_BACKGROUND = 0.2  #: share of the counts
CHUNK = 64  #: pairs that are tried together

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]


@dataclass(frozen=True)
class Found:
    """What the oracle finds in one pixel.

    Attributes
    ----------
    pair_m : tuple of float
        Depths of the most likely pair, m.
    gain : float
        Twice the logarithm of its likelihood over that of the most likely single surface.
    """

    pair_m: tuple[float, float]
    gain: float


class Oracle:
    """Search for one and for two surfaces within a range of depths, m."""

    def __init__(self, range_m: tuple[float, float]) -> None:
        self.edges = edges_ns(BIN_NS)
        self.step_m = FINER_M[-1]
        self.first_m = range_m[0]
        self.last = round((range_m[1] - range_m[0]) / self.step_m)
        depths = range_m[0] + self.step_m * np.arange(self.last + 1)
        self.shares = band_shares(depths, edges=self.edges)
        self.flat = np.diff(self.edges)[None] / PERIOD_NS

    def find(self, counts: Floats) -> Found:
        """Return the most likely pair for counts (bin,) in time order, and its gain."""
        _, single = self._most_likely(counts, surfaces=1)
        pair, likelihood = self._most_likely(counts, surfaces=2)
        near, far = (float(self.first_m + self.step_m * number) for number in sorted(pair))
        return Found((near, far), 2 * (likelihood - single))

    def _most_likely(self, counts: Floats, *, surfaces: int) -> tuple[Numbers, float]:
        """Numbers of the most likely depths, and the logarithm of their likelihood."""
        grid = np.arange(0, self.last + 1, round(STEP_M / self.step_m))
        chosen = np.array(list(combinations(grid, surfaces)))
        if surfaces == 2:
            chosen = chosen[np.diff(chosen)[:, 0] * self.step_m >= LEAST_APART_M]
        scores = self._scores(counts, chosen, GRID_ROUNDS)
        starts: list[Numbers] = []
        for number in np.argsort(-scores):
            away = [np.abs(chosen[number] - other).max() * self.step_m for other in starts]
            if all(far > 2 * STEP_M for far in away):
                starts.append(chosen[number])
            if len(starts) == BEST:
                break
        return max((self._refined(counts, start) for start in starts), key=lambda one: one[1])

    def _refined(self, counts: Floats, start: Numbers) -> tuple[Numbers, float]:
        """The most likely depths of finer grids around a start."""
        best, likelihood = start, -np.inf
        for step_m in FINER_M:
            steps = round(step_m / self.step_m) * np.arange(-2, 3)
            moves = np.array(list(product(steps, repeat=start.size)))
            near = np.clip(best + moves, 0, self.last)
            scores = self._scores(counts, near, FINAL_ROUNDS)
            best, likelihood = near[np.argmax(scores)], float(scores.max())
        return best, likelihood

    def _scores(self, counts: Floats, chosen: Numbers, rounds: int) -> Floats:
        """Log-likelihoods of surfaces at chosen depths (n, surface)."""
        scores = np.empty(len(chosen))
        for first in range(0, len(chosen), CHUNK):
            light = self.shares[chosen[first : first + CHUNK]]
            light = light.reshape(len(light), -1, self.flat.size)
            flat = np.broadcast_to(self.flat, (len(light), 1, self.flat.size))
            model = np.concatenate([light, flat], axis=1)
            scores[first : first + CHUNK] = fitted(counts, model, rounds)
        return scores


def fitted(counts: Floats, model: Floats, rounds: int) -> Floats:
    """Return the log-likelihood of counts (bin,) with parts (n, part, bin) that are not negative.

    The last part is the background. Factors of expectation maximization are raised to the power
    1.5 in all but the last rounds, which is still sure to converge (below 2).
    """
    parts = model.shape[1]
    theta = np.full((len(model), parts), counts.sum() * (1 - START_BACKGROUND) / (parts - 1))
    theta[:, -1] = START_BACKGROUND * counts.sum()
    whole = np.maximum(model.sum(axis=-1), 1e-9)
    turned = np.ascontiguousarray(model.transpose(0, 2, 1))
    for number in range(rounds):
        mean = (theta[:, None] @ model)[:, 0]
        factor = ((counts / np.maximum(mean, 1e-12))[:, None] @ turned)[:, 0] / whole
        theta = theta * (factor**1.5 if number < rounds - 3 else factor)
    mean = np.maximum((theta[:, None] @ model)[:, 0], 1e-12)
    return np.asarray((counts * np.log(mean)).sum(axis=-1) - mean.sum(axis=-1))
