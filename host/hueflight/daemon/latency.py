"""How long after its last photon a picture is on a screen, and where the time goes."""

from __future__ import annotations

from collections import deque

from hueflight.daemon.pictures import Picture

KEPT = 2048
WINDOW_S = 30.0  #: what is older is forgotten
QUANTILES = (("p50", 0.5), ("p95", 0.95), ("p99", 0.99))


class Latencies:
    """The latest delays, from last photon to the browser's answer that the picture is shown."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, tuple[float, float, float]]] = deque(maxlen=KEPT)

    def shown(self, picture: Picture, now_s: float) -> None:
        """Book a picture that is on a screen since `now_s`, monotonic clock."""
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
        while self._seen[0][0] < now_s - WINDOW_S:
            self._seen.popleft()

    def as_dict(self) -> dict[str, float] | None:
        """Quantiles of the whole, and medians of its parts, seconds; None before the first.

        The parts are `waiting` for the picture before, `making` this one, and `showing` it: coding,
        the way to the browser, drawing, and the answer's way back.
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
