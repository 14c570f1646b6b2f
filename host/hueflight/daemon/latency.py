# SPDX-License-Identifier: Apache-2.0
"""Time from the last photon of a picture until a viewer sees it, and where that time goes."""

from __future__ import annotations

from collections import deque

from hueflight.acquisition.delay_histogram import DelayHistogram
from hueflight.daemon.picture import Picture

KEPT = 2048
WINDOW_S = 30.0  #: older latencies are forgotten
QUANTILES = (("p50", 0.5), ("p95", 0.95), ("p99", 0.99))


class LatencyMeter:
    """Latest times from last photon to the browser's answer that the picture is on the screen.

    Attributes
    ----------
    delays : DelayHistogram
        All of these times since the program began.
    """

    def __init__(self) -> None:
        self.delays = DelayHistogram()
        self._seen: deque[tuple[float, tuple[float, float, float]]] = deque(maxlen=KEPT)

    def shown(self, picture: Picture, now_s: float) -> None:
        """Note that a picture is on a screen.

        Parameters
        ----------
        picture : Picture
            The picture.
        now_s : float
            Monotonic clock, in seconds.
        """
        self._seen.append(
            (
                now_s,
                (
                    picture.begun_s - picture.received_s,
                    picture.ready_s - picture.begun_s,
                    now_s - picture.ready_s,
                ),
            )
        )
        self.delays.add(now_s - picture.received_s)
        while self._seen[0][0] < now_s - WINDOW_S:
            self._seen.popleft()

    def as_dict(self) -> dict[str, float] | None:
        """Return quantiles of the latency and medians of its parts.

        The parts are `waiting` for the picture before, `making` this one, and `showing` it:
        encoding, transfer to the browser, drawing, and the transfer of the browser's answer.

        Returns
        -------
        dict of float, or None
            Seconds by name; None until a picture has been shown.
        """
        if not self._seen:
            return None
        seen = [parts for _, parts in list(self._seen)]
        whole = [sum(parts) for parts in seen]
        found = {name: _quantile(whole, share) for name, share in QUANTILES}
        for place, name in enumerate(("waiting", "making", "showing")):
            found[name] = _quantile([parts[place] for parts in seen], 0.5)
        return found


def _quantile(values: list[float], share: float) -> float:
    return round(sorted(values)[min(len(values) - 1, int(share * len(values)))], 4)
