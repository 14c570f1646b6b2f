# SPDX-License-Identifier: Apache-2.0
"""Live pictures: the newest blocks are reconstructed in a thread of their own, older ones not."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

import structlog
import xarray as xr

from hueflight import backend
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.calibration import Calibration
from hueflight.daemon.block_window import PARTS, BlockWindow
from hueflight.daemon.incremental_fitter import CHANGE_SIGMA, IncrementalFitter
from hueflight.daemon.picture import Picture, count_photons
from hueflight.errors import HueflightError
from hueflight.ingest.accumulator import Counts
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.entry_point import METHODS, reconstruct

UNSEEN_S = 1.0  #: from picture to picture while nobody is watching
PATIENCE_S = 330.0  #: for one picture; the NumPy definition of the joint fit takes minutes
_WAIT_S = 0.5
log = structlog.get_logger("hueflight.daemon")


def live_method() -> str:
    """Return the best method that keeps up with live pictures.

    This is the joint fit where the compiled one runs. Its NumPy definition takes most of a minute
    for a picture of 192 × 128 pixels.
    """
    return "joint" if backend.compiled("fit") is not None else "paper"


class Pictures:
    """Reconstructs the newest blocks in a thread of its own.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the histograms.
    method : str
        Method of reconstruction; empty for the best one that keeps up.
    window_blocks : int
        Blocks that are summed for each picture.
    change_sigma : float
        With the joint method, standard deviations by which a pixel must have changed to be fitted
        again at once; 0 fits every pixel of every picture. See `IncrementalFitter`.
    threads : int
        Threads over pixels.
    on_picture : callable
        Called with each picture, in the thread of this class.
    is_watched : callable
        Returns True if somebody is watching. Otherwise one picture a second is made, for clients
        that ask later.

    Attributes
    ----------
    calibration : Calibration or None
        Calibration that is used from the next picture on; None shows photons only.
    latest : Picture or None
        The newest picture.
    made : int
        Pictures made so far.
    skipped : int
        Blocks that were outdated before they were reconstructed.
    problem : str
        Why the latest histogram could not be reconstructed; empty if it could.
    thread : SupervisedThread
        Thread that reconstructs, which begins anew after a fault of the program.
    """

    def __init__(
        self,
        instrument: Instrument,
        /,
        *,
        method: str = "",
        window_blocks: int = 1,
        change_sigma: float = CHANGE_SIGMA,
        threads: int = 1,
        on_picture: Callable[[Picture], None],
        is_watched: Callable[[], bool] = lambda: True,
    ) -> None:
        if method and method not in METHODS:
            raise HueflightError(f"method = {method!r}: choose one of {', '.join(METHODS)}")
        self.instrument = instrument
        self.method = method or live_method()
        self.calibration: Calibration | None = None
        self.latest: Picture | None = None
        self.made = self.skipped = 0
        self._making = False
        self.problem = ""
        self._on_picture = on_picture
        self._is_watched = is_watched
        self._threads = threads
        self._fitter = IncrementalFitter(change_sigma=change_sigma, threads=threads)
        self._waiting: deque[LiveBlock] = deque()
        self._window = BlockWindow(window_blocks)
        self._next_window: BlockWindow | None = None
        self._old_blocks = 0  # still to come, which began before the next window
        self._changed = threading.Condition()
        self._closing = False
        self._change_sigma = change_sigma
        self.thread = SupervisedThread(
            self._work, name="pictures", on_failure=self._begin_anew, patience_s=PATIENCE_S
        )
        self.thread.start()

    def offer(self, block: LiveBlock, /) -> None:
        """Take the next block; never waits for reconstruction."""
        with self._changed:
            if self._old_blocks:
                self._old_blocks -= 1
                block.give_back()
                return
            self._waiting.append(block)
            if len(self._waiting) > 1:
                self.skipped += 1
            # those beyond the window would drop out of the sum at once; each one occupies memory
            window = self._next_window or self._window
            while len(self._waiting) > min(window.length, PARTS):
                self._waiting.popleft().give_back()
            self._changed.notify()

    def begin_anew(self, window: BlockWindow, /) -> int:
        """Sum only blocks that begin from now on.

        Parameters
        ----------
        window : BlockWindow
            Window that sums the blocks from now on.

        Returns
        -------
        int
            Number of the latest picture that may hold older photons. Later ones hold none.
        """
        with self._changed:
            while self._waiting:
                self._waiting.popleft().give_back()
            self._next_window, self._old_blocks = window, 1
            return self.made + self._making

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self.thread.end()
        self.thread.join(10)

    def _work(self) -> None:
        # acquisition comes first; threads that help with a picture inherit this
        set_thread_priority(ThreadPriority.RECONSTRUCTION)
        while True:
            self.thread.beat()
            with self._changed:
                if not self._waiting and not self._closing:
                    self._changed.wait(_WAIT_S)
                if self._closing:
                    return
                if self._next_window is not None:
                    self._window.clear()
                    self._window, self._next_window = self._next_window, None
                blocks = list(self._waiting)
                self._waiting.clear()
                self._making = bool(blocks)
            if not blocks:
                continue
            begun_s = time.monotonic()
            for block in blocks:
                self._window.add(block)
            if self._is_wanted(begun_s):
                self._make(blocks[-1], self._window.histogram(), self._window.frames, begun_s)

    def _begin_anew(self, reason: str, trace: str) -> None:
        """After a fault of the program: forget what may have caused it."""
        log.error("pictures failed", reason=reason, traceback=trace)
        self._window.clear()
        self._fitter = IncrementalFitter(change_sigma=self._change_sigma, threads=self._threads)

    def _is_wanted(self, now: float) -> bool:
        """Whether somebody is watching, or would find the latest picture too old."""
        return self.latest is None or self._is_watched() or now - self.latest.begun_s >= UNSEEN_S

    def _make(self, newest: LiveBlock, histogram: Counts, frames: int, begun_s: float) -> None:
        image = self._reconstruct(histogram, newest.kind, frames)
        with self._changed:
            self.made, self._making = self.made + 1, False
        clock_hz = newest.block.clock_hz
        picture = Picture(
            number=self.made,
            kind=newest.kind,
            histogram=histogram,
            image=image,
            photons=count_photons(histogram, image, self.instrument, frames),
            frames=frames,
            device_s=newest.block.last_tick / clock_hz if clock_hz else 0.0,
            received_s=newest.received_s,
            begun_s=begun_s,
            ready_s=time.monotonic(),
        )
        self.latest = picture
        self._on_picture(picture)
        self.thread.recovered()

    def _reconstruct(self, histogram: Counts, kind: str, frames: int) -> xr.Dataset | None:
        calibration = self.calibration
        if calibration is None or kind not in ("scene", "reference"):
            return None
        try:
            if self.method == "joint":
                image = self._fitter.fit(histogram, calibration, frames)
            else:
                image = reconstruct(
                    histogram, calibration, method=self.method, threads=self._threads
                )
        except HueflightError as error:
            self.problem = str(error)
            return None
        self.problem = ""
        return image
