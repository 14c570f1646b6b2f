# SPDX-License-Identifier: Apache-2.0
"""Live pictures: the newest blocks are reconstructed in a thread of their own, older ones not."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import structlog
import xarray as xr
from numpy.typing import NDArray

from hueflight import backend
from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.snapshot import LiveBlock, LiveSums
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.calibration import Calibration
from hueflight.daemon.block_window import BlockWindow
from hueflight.daemon.gathered_window import GatheredWindow
from hueflight.daemon.incremental_fitter import CHANGE_SIGMA, IncrementalFitter
from hueflight.daemon.picture import NO_HISTOGRAM, Picture, count_photons
from hueflight.daemon.picture_settings import PictureSettings
from hueflight.daemon.picture_window import PictureWindow
from hueflight.daemon.sums_window import GatheredSums, SumsWindow
from hueflight.errors import HueflightError
from hueflight.ingest.accumulator import Counts
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.entry_point import reconstruct

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
        Instrument of the histograms. Those of another schedule are not shown.
    method : str
        Method of reconstruction; empty for the best one that keeps up.
    integration_s : float
        Longest time over which photons add up; see `PictureSettings`.
    window_blocks : int
        Blocks that are summed for each picture where `integration_s` is 0.
    rate_hz : float
        Frames per second to expect.
    block_frames : int
        Frames from one block to the next.
    change_sigma : float
        With the joint method and where photons do not add up, standard deviations by which a pixel
        must have changed to be fitted again at once; 0 fits every pixel of every picture. See
        `IncrementalFitter`.
    threads : int
        Threads over pixels.
    on_picture : callable
        Called with each picture, in the thread of this class.
    is_watched : callable
        Returns True if somebody is watching. Otherwise one picture a second is made, for clients
        that ask later.

    Attributes
    ----------
    settings : PictureSettings
        How pictures are made; see `change`.
    calibration : Calibration or None
        Calibration that is used from the next picture on; None shows photons only.
    latest : Picture or None
        The newest picture.
    made : int
        Pictures made so far.
    skipped : int
        Blocks that were outdated before they were reconstructed.
    reduced : bool
        True if the newest block was a picture of sums, of which the latest picture is made. Of
        `settings`, the method is then that of sums.
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
        integration_s: float = 0.0,
        window_blocks: int = 1,
        rate_hz: float = 1000.0,
        block_frames: int = 1,
        change_sigma: float = CHANGE_SIGMA,
        threads: int = 1,
        on_picture: Callable[[Picture], None],
        is_watched: Callable[[], bool] = lambda: True,
    ) -> None:
        self.instrument = instrument
        self.settings = PictureSettings(integration_s, method or live_method())
        self.calibration: Calibration | None = None
        self.latest: Picture | None = None
        self.made = self.skipped = 0
        self.reduced = False
        self._making = False
        self._distinct_frames: int | None = None
        self.problem = ""
        self._on_picture = on_picture
        self._is_watched = is_watched
        self._threads = threads
        self._change_sigma = change_sigma
        self._fitter = self._new_fitter()
        self._waiting: deque[LiveBlock | LiveSums] = deque()
        self._window_blocks, self._rate_hz = window_blocks, rate_hz
        self._block_frames = block_frames
        self._window = self._make_window(self.settings)
        self._sums = self._make_sums_window(self.settings)
        self._next_window: PictureWindow | None = None
        self._filling = False  # since it began anew
        self._old_blocks = 0  # still to come, which began before the next window
        self._changed = threading.Condition()
        self._closing = False
        self.thread = SupervisedThread(
            self._work, name="pictures", on_failure=self._begin_anew, patience_s=PATIENCE_S
        )
        self.thread.start()

    def offer(self, block: LiveBlock | LiveSums, /) -> None:
        """Take the next block; never waits for reconstruction."""
        with self._changed:
            if block.instrument != self.instrument:
                block.give_back()
                return
            if self._old_blocks:
                self._old_blocks -= 1
                block.give_back()
                return
            self._waiting.append(block)
            if len(self._waiting) > 1:
                self.skipped += 1
            window = self._next_window or self._window
            while len(self._waiting) > window.most_waiting:  # each one occupies memory
                self._waiting.popleft().give_back()
            self._changed.notify()

    def change(self, settings: PictureSettings, /) -> tuple[int, int]:
        """Make the next pictures in another way, of photons that come from now on.

        Parameters
        ----------
        settings : PictureSettings
            How to make pictures.

        Returns
        -------
        frames : int
            Frames that each picture has at least, once so many were taken.
        number : int
            Number of the latest picture that may hold older photons.
        """
        window = self._make_window(settings)
        self.settings = settings
        least = self._make_sums_window(settings).length if self.reduced else window.least
        return least * self._block_frames, self.begin_anew(window)

    def follow(self, run: RunSettings, instrument: Instrument, /) -> None:
        """Make pictures of another stream, begun anew.

        Parameters
        ----------
        run : RunSettings
            How the stream is cut from now on.
        instrument : Instrument
            Instrument of the histograms from now on. If its schedule is another one, there is no
            calibration until one is given.
        """
        if instrument != self.instrument:
            self.calibration = self.latest = None
            with self._changed:
                self.instrument = instrument
        self._window_blocks, self._rate_hz = run.window_blocks, run.rate_hz
        self._block_frames = run.block_frames
        self.change(self.settings)

    def limit_frames(self, distinct_frames: int | None, /) -> None:
        """Let no photons add up that a simulated camera only repeats.

        Parameters
        ----------
        distinct_frames : int or None
            Number of frames after which they are repeated; None if they never are.
        """
        if distinct_frames != self._distinct_frames:
            self._distinct_frames = distinct_frames
            self.change(self.settings)

    def begin_anew(self, window: PictureWindow, /) -> int:
        """Sum only blocks that begin from now on.

        Parameters
        ----------
        window : PictureWindow
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
                    self._sums = self._make_sums_window(self.settings)
                    self._filling = True
                blocks = list(self._waiting)
                self._waiting.clear()
                self._making = bool(blocks)
            if not blocks:
                continue
            begun_s = time.monotonic()
            if isinstance(blocks[-1], LiveSums):
                self._make_of_sums(blocks, begun_s)
                continue
            if self.reduced:
                self.reduced, self._filling = False, True
                self._sums.clear()
            histograms = [block for block in blocks if isinstance(block, LiveBlock)]
            self._window.add_all(histograms)
            if self._filling:  # no pixel may keep an estimate from fewer or older photons
                self._fitter = self._new_fitter()
                self._filling = not self._window.full
            if self._is_wanted(begun_s):
                self._make(histograms[-1], self._window.histogram(), self._window, begun_s)

    def _make_window(self, settings: PictureSettings) -> PictureWindow:
        if settings.integration_s == 0:
            frames = settings.frames
            if frames:
                return BlockWindow.holding(-(-frames // self._block_frames))
            return BlockWindow(self._window_blocks)
        return GatheredWindow(self.instrument, self._seconds(settings), self._rate_hz)

    def _make_sums_window(self, settings: PictureSettings) -> SumsWindow:
        if settings.integration_s == 0:
            frames = settings.frames or self._window_blocks * self._block_frames
            return SumsWindow(-(-frames // self._block_frames), frames)
        seconds = self._seconds(settings)
        return GatheredSums(None if math.isinf(seconds) else max(1, round(seconds * self._rate_hz)))

    def _seconds(self, settings: PictureSettings) -> float:
        """Longest time over which photons add up."""
        if self._distinct_frames is None:
            return settings.integration_s
        # photons that are repeated would add nothing
        return min(settings.integration_s, self._distinct_frames / self._rate_hz)

    def _begin_anew(self, reason: str, trace: str) -> None:
        """After a fault of the program: forget what may have caused it."""
        log.error("pictures failed", reason=reason, traceback=trace)
        self._window.clear()
        self._sums.clear()
        self._fitter = self._new_fitter()

    def _new_fitter(self) -> IncrementalFitter:
        return IncrementalFitter(change_sigma=self._change_sigma, threads=self._threads)

    def _is_wanted(self, now: float) -> bool:
        """Whether somebody is watching, or would find the latest picture too old."""
        return self.latest is None or self._is_watched() or now - self.latest.begun_s >= UNSEEN_S

    def _make(
        self,
        newest: LiveBlock,
        histogram: Counts,
        window: PictureWindow,
        begun_s: float,
    ) -> None:
        frames = window.frames_by_pixel
        image = self._reconstruct(histogram, newest, frames)
        photons = count_photons(histogram, image, self.instrument, frames)
        by_pixel = np.broadcast_to(frames, photons.shape)
        clock_hz = newest.block.clock_hz
        self._publish(newest, clock_hz, histogram, image, photons, by_pixel, begun_s)

    def _make_of_sums(self, blocks: Sequence[LiveBlock | LiveSums], begun_s: float) -> None:
        """Make a picture of the newest pictures of sums."""
        if not self.reduced:
            self.reduced = True
            self._window.clear()
        for block in blocks:  # histograms of an earlier run
            block.give_back()
        newest = blocks[-1]
        assert isinstance(newest, LiveSums)
        window, calibration, image = self._sums, self.calibration, None
        try:
            window.add_all([block for block in blocks if isinstance(block, LiveSums)])
            if not self._is_wanted(begun_s):
                return
            if calibration is not None and newest.instrument == self.instrument:
                image = window.reconstruct(calibration)
            self.problem = ""
        except HueflightError as error:
            self.problem = str(error)
            if window.empty:
                return
        frames, photons = window.frames_by_pixel, window.photons
        self._publish(newest, newest.clock_hz, NO_HISTOGRAM, image, photons, frames, begun_s)

    def _publish(
        self,
        newest: LiveBlock | LiveSums,
        clock_hz: int,
        histogram: Counts,
        image: xr.Dataset | None,
        photons: NDArray[np.integer],
        frames: NDArray[np.integer],
        begun_s: float,
    ) -> None:
        with self._changed:
            self.made, self._making = self.made + 1, False
        picture = Picture(
            number=self.made,
            kind=newest.kind,
            histogram=histogram,
            image=image,
            photons=photons,
            frames=int(frames.max()),
            frames_by_pixel=frames,
            device_s=newest.block.last_tick / clock_hz if clock_hz else 0.0,
            received_s=newest.received_s,
            begun_s=begun_s,
            ready_s=time.monotonic(),
        )
        self.latest = picture
        self._on_picture(picture)
        self.thread.recovered()

    def _reconstruct(
        self, histogram: Counts, newest: LiveBlock, frames: int | NDArray[np.int64]
    ) -> xr.Dataset | None:
        # in this order: `follow` takes the calibration away before it changes the instrument
        calibration, method = self.calibration, self.settings.method
        if calibration is None or newest.kind not in ("scene", "reference"):
            return None
        if newest.instrument != self.instrument:
            return None
        try:
            if method == "joint":
                image = self._fitter.fit(histogram, calibration, frames)
            else:
                known = None if self.instrument.sensor.reports_empty else frames
                image = reconstruct(
                    histogram, calibration, method=method, frames=known, threads=self._threads
                )
        except HueflightError as error:
            self.problem = str(error)
            return None
        self.problem = ""
        return image
