# SPDX-License-Identifier: Apache-2.0
"""Rates of running totals, averaged over the last two seconds."""

from __future__ import annotations

from collections import deque

WINDOW_S = 2.0
_LEAST_S = 0.2


class RateMeter:
    """Turns running totals into rates per second."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, dict[str, int]]] = deque()

    def update(self, now: float, **totals: int) -> None:
        """Take the present totals.

        Parameters
        ----------
        now : float
            Monotonic clock, in seconds.
        **totals : int
            Totals by name.
        """
        if self._samples and now - self._samples[-1][0] < _LEAST_S:
            return
        self._samples.append((now, totals))
        while len(self._samples) > 2 and now - self._samples[1][0] >= WINDOW_S:
            self._samples.popleft()

    def per_second(self) -> dict[str, float]:
        """Return rates by name; empty until there are two samples."""
        if len(self._samples) < 2:
            return {}
        (then, old), (now, new) = self._samples[0], self._samples[-1]
        return {name: (new[name] - old.get(name, 0)) / (now - then) for name in new}
