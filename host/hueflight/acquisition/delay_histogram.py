# SPDX-License-Identifier: Apache-2.0
"""How often something took how long, in fixed steps: what monitoring can sum and compare."""

from __future__ import annotations

import threading
from bisect import bisect_left

#: upper limits of the steps, in seconds; each is about twice the one before
BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


class DelayHistogram:
    """Counts delays by their length, since the program began.

    Parameters
    ----------
    bounds_s : tuple of float
        Upper limits of the steps, rising, in seconds; longer delays have a step of their own.
    """

    def __init__(self, bounds_s: tuple[float, ...] = BOUNDS_S, /) -> None:
        self._bounds_s = bounds_s
        self._counts = [0] * (len(bounds_s) + 1)
        self._sum_s = 0.0
        self._lock = threading.Lock()

    def add(self, *delays_s: float) -> None:
        """Count delays.

        Parameters
        ----------
        *delays_s : float
            Delays in seconds.
        """
        with self._lock:
            for delay_s in delays_s:
                self._counts[bisect_left(self._bounds_s, delay_s)] += 1
                self._sum_s += delay_s

    def cumulative(self) -> tuple[list[tuple[float, int]], float]:
        """Return how many delays were at most so long.

        Returns
        -------
        steps : list of (float, int)
            Upper limit in seconds and number of delays up to it; the last limit is infinite.
        sum_s : float
            Sum of all delays in seconds.
        """
        with self._lock:
            counts, sum_s = list(self._counts), self._sum_s
        total, steps = 0, []
        for bound_s, count in zip((*self._bounds_s, float("inf")), counts, strict=True):
            total += count
            steps.append((bound_s, total))
        return steps, sum_s
