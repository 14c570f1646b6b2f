"""A run that ends when enough is known: looks at what has been counted, beside the acquisition."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.thread_priority import ThreadPriority, adopt
from hueflight.calibration import Calibration
from hueflight.reconstruction.reconstruct import reconstruct
from hueflight.reconstruction.stopping import StopRule, frames_needed, seen_enough, share_known

LEAST_GROWTH, MOST_GROWTH = 1.1, 2.0  #: of the frames from one look to the next


@dataclass(frozen=True)
class PrecisionStop:
    """What must be known for a run to end, and the calibration that tells.

    Attributes
    ----------
    rule : what is wanted, of how many pixels.
    calibration : of the same instrument.
    """

    rule: StopRule
    calibration: Calibration


class PrecisionMonitor:
    """Reconstructs a run's histogram now and then, in a thread of its own.

    Looks come at growing numbers of frames, as soon as the last one said that they may do.

    Parameters
    ----------
    until : what must be known.

    Attributes
    ----------
    share : of the pixels that are known well enough, at the last look; None before the first.
    met : whether that is enough.
    """

    def __init__(self, until: PrecisionStop, /) -> None:
        self.share: float | None = None
        self.met = False
        self._until = until
        self._sum: NDArray[np.uint32] | None = None
        self._frames = 0
        self._next_look = 1.0
        self._looking: Future[tuple[float, bool, float]] | None = None
        self._thread = ThreadPoolExecutor(
            1,
            thread_name_prefix="until",
            initializer=adopt,
            initargs=(ThreadPriority.RECONSTRUCTION,),
        )

    @property
    def looking(self) -> bool:
        """Whether a look is on whose result has not been taken."""
        return self._looking is not None

    def add(self, counts: NDArray[np.unsignedinteger], frames: int) -> None:
        """Take a block of the run's frames into account."""
        if self._sum is None:
            self._sum = np.zeros(counts.shape, np.uint32)
        self._sum += counts
        self._frames += frames

    def poll(self) -> bool:
        """Whether enough is known; begins the next look when it is due. Never waits for one.

        Raises
        ------
        HueflightError
            If the histogram does not fit the calibration.
        """
        if self._looking is not None and self._looking.done():
            looked, self._looking = self._looking, None
            self.share, self.met, self._next_look = looked.result()
        due = self._frames >= self._next_look and not self.met
        if self._looking is None and due and self._sum is not None:
            self._looking = self._thread.submit(self._look, self._sum.copy(), self._frames)
        return self.met

    def close(self) -> None:
        """Look no more."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _look(self, counts: NDArray[np.uint32], frames: int) -> tuple[float, bool, float]:
        calibration, rule = self._until.calibration, self._until.rule
        known = None if calibration.instrument.sensor.reports_empty else frames
        image = reconstruct(counts, calibration, frames=known)
        wanted = frames_needed(image, rule, frames)
        following = min(max(wanted, LEAST_GROWTH * frames), MOST_GROWTH * frames)
        return share_known(image, rule), seen_enough(image, rule), following
