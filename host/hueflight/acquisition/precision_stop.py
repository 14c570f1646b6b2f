# SPDX-License-Identifier: Apache-2.0
"""Precision stop: a run ends when depth or reflectance is known precisely enough."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.calibration import Calibration
from hueflight.reconstruction.entry_point import reconstruct
from hueflight.reconstruction.stopping import StopRule, frames_needed, seen_enough, share_known

LEAST_GROWTH, MOST_GROWTH = 1.1, 2.0  #: of frames from one reconstruction to the next


@dataclass(frozen=True)
class PrecisionStop:
    """Precision at which a run ends, and the calibration that it is estimated with.

    Attributes
    ----------
    rule : StopRule
        Standard deviations that must be reached, and the fraction of pixels that must reach them.
    calibration : Calibration
        Calibration of the same instrument.
    """

    rule: StopRule
    calibration: Calibration


class PrecisionMonitor:
    """Reconstructs a run's histogram now and then, in a thread of its own.

    The numbers of frames grow from one reconstruction to the next, as far as the last one expects
    to be necessary.

    Parameters
    ----------
    stop : PrecisionStop
        Precision that is wanted.

    Attributes
    ----------
    share : float or None
        Fraction of pixels that had the wanted precision at the last reconstruction; None before
        the first.
    met : bool
        True if that is enough.
    """

    def __init__(self, stop: PrecisionStop, /) -> None:
        self.share: float | None = None
        self.met = False
        self._stop = stop
        self._sum: NDArray[np.uint32] | None = None
        self._frames = 0
        self._next_look = 1.0
        self._looking: Future[tuple[float, bool, float]] | None = None
        self._thread = ThreadPoolExecutor(
            1,
            thread_name_prefix="precision-stop",
            initializer=set_thread_priority,
            initargs=(ThreadPriority.RECONSTRUCTION,),
        )

    @property
    def looking(self) -> bool:
        """True while a reconstruction is on whose result has not been taken."""
        return self._looking is not None

    def add(self, counts: NDArray[np.unsignedinteger], frames: int) -> None:
        """Add a block of the run's frames.

        Parameters
        ----------
        counts : ndarray, shape (row, col, code)
            Histogram of the block.
        frames : int
            Number of frames in it.
        """
        if self._sum is None:
            self._sum = np.zeros(counts.shape, np.uint32)
        self._sum += counts
        self._frames += frames

    def poll(self) -> bool:
        """Return whether the precision is reached; start the next reconstruction when it is due.

        Returns
        -------
        bool
            True if enough pixels had the precision at the last reconstruction. Never waits for
            one.

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
        """Stop reconstructing."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _look(self, counts: NDArray[np.uint32], frames: int) -> tuple[float, bool, float]:
        calibration, rule = self._stop.calibration, self._stop.rule
        known = None if calibration.instrument.sensor.reports_empty else frames
        image = reconstruct(counts, calibration, frames=known, mixed=False, second_returns=False)
        wanted = frames_needed(image, rule, frames)
        following = min(max(wanted, LEAST_GROWTH * frames), MOST_GROWTH * frames)
        return share_known(image, rule), seen_enough(image, rule), following
