"""Live pictures: the newest histogram reconstructed, again and again; older ones are skipped."""

from __future__ import annotations

import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight import backend
from hueflight.acquisition.snapshot import LiveBlock
from hueflight.acquisition.thread_priority import ThreadPriority, adopt
from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.ingest.accumulator import Counts
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.reconstruct import METHODS, reconstruct
from hueflight.reconstruction.video import Video

CHANGE_SIGMA = 4.0  #: see `Video`
REFRESH_S = 10.0  #: in which every pixel is fitted again: chance may have misled a kept fit
GROWTH = 1.1  #: by so much more frames than behind the kept fits, all pixels are fitted again
UNSEEN_S = 1.0  #: from picture to picture while nobody looks
_WAIT_S = 0.5


def live_method() -> str:
    """Return the best method that keeps up with live pictures.

    That is the joint fit where the compiled one runs; its NumPy definition takes most of a minute
    for an image of the paper's size.
    """
    return "joint" if backend.compiled("fit") is not None else "paper"


@dataclass(frozen=True, eq=False)
class Picture:
    """What there is to see at one moment.

    Attributes
    ----------
    number : counts pictures from 1.
    kind : of the run.
    counts : the histogram behind it, (row, col, code). Its memory serves again when nobody holds
        this array; a view of it does not hold it.
    image : reconstructed, None without a calibration.
    photons : (row, col).
    frames : behind it.
    device_s : device clock at the start of its last exposure, seconds.
    received_s, begun_s, ready_s : monotonic clock when its last photon had arrived, when work on
        it began, and when it was done.
    """

    number: int
    kind: str
    counts: Counts
    image: xr.Dataset | None
    photons: NDArray[np.integer]
    frames: int
    device_s: float
    received_s: float
    begun_s: float
    ready_s: float


class Pictures:
    """Reconstructs in a thread of its own.

    Parameters
    ----------
    instrument : of the histograms.
    method : see `reconstruct`; empty for the best that is fast enough.
    window_blocks : each picture is of the sum of so many histograms, the newest ones.
    change_sigma : of the joint method, pixels that have changed by less keep what was found of
        them for up to `REFRESH_S`; 0 fits every pixel of every picture. See `Video`.
    threads : that share its pixels.
    on_picture : told of each picture, in the thread.
    looked_at : whether anybody looks; if not, a picture a second is enough for who asks later.

    Attributes
    ----------
    calibration : used from the next picture on; None shows photons alone.
    latest : the newest picture.
    made, skipped : pictures reconstructed, and histograms that were too old by then.
    problem : why the latest histogram gave no image; empty if it did.
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
        looked_at: Callable[[], bool] = lambda: True,
    ) -> None:
        if method and method not in METHODS:
            raise HueflightError(f"method = {method!r}: choose one of {', '.join(METHODS)}")
        self.instrument = instrument
        self.method = method or live_method()
        self.calibration: Calibration | None = None
        self.latest: Picture | None = None
        self.made = self.skipped = 0
        self.problem = ""
        self._on_picture = on_picture
        self._looked_at = looked_at
        self._threads = threads
        self._film = IncrementalFitter(change_sigma=change_sigma, threads=threads)
        self._waiting: deque[LiveBlock] = deque()
        self._window = _Window(window_blocks)
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="pictures", daemon=True)
        self._thread.start()

    def offer(self, block: LiveBlock, /) -> None:
        """Take a histogram; never blocks."""
        with self._changed:
            self._waiting.append(block)
            if len(self._waiting) > 1:
                self.skipped += 1
            while len(self._waiting) > self._window.blocks:  # would fall out of the sum at once
                self._waiting.popleft().give_back()
            self._changed.notify()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout=10)

    def _work(self) -> None:
        # acquisition comes first; threads that help with a picture inherit this
        adopt(ThreadPriority.RECONSTRUCTION)
        while True:
            with self._changed:
                if not self._waiting and not self._closing:
                    self._changed.wait(_WAIT_S)
                if self._closing:
                    return
                blocks = list(self._waiting)
                self._waiting.clear()
            if not blocks:
                continue
            begun_s = time.monotonic()
            for live in blocks:
                self._window.add(live)
            if not self._wanted(begun_s):
                continue
            self._make(blocks[-1], self._window.counts(), self._window.frames, begun_s)

    def _wanted(self, now: float) -> bool:
        """Whether anybody looks, or may ask for a picture later and find it too old."""
        return self.latest is None or self._looked_at() or now - self.latest.begun_s >= UNSEEN_S

    def _make(self, live: LiveBlock, counts: Counts, frames: int, begun_s: float) -> None:
        block = live.block
        image = self._reconstruct(counts, live.kind, frames)
        first = int(self.instrument.sensor.reports_empty)
        photons = (
            image["photons"].values.astype(np.int64)
            if image is not None
            else frames - counts[..., 0].astype(np.int64)
            if first
            else counts.sum(axis=-1, dtype=np.int64)
        )
        self.made += 1
        picture = Picture(
            number=self.made,
            kind=live.kind,
            counts=counts,
            image=image,
            photons=photons,
            frames=frames,
            device_s=block.last_tick / block.clock_hz if block.clock_hz else 0.0,
            received_s=live.received_s,
            begun_s=begun_s,
            ready_s=time.monotonic(),
        )
        self.latest = picture
        self._on_picture(picture)

    def _reconstruct(self, counts: Counts, kind: str, frames: int) -> xr.Dataset | None:
        calibration = self.calibration
        if calibration is None or kind not in ("scene", "reference"):
            return None
        try:
            if self.method == "joint":
                image = self._film.next(counts, calibration, frames)
            else:
                image = reconstruct(counts, calibration, method=self.method, threads=self._threads)
        except HueflightError as error:
            self.problem = str(error)
            return None
        self.problem = ""
        return image


class IncrementalFitter:
    """The joint fit from picture to picture: what is still need not be fitted again each time.

    Yet all pixels are within `REFRESH_S`, some in each picture, so that none takes much longer.
    """

    def __init__(self, *, change_sigma: float, threads: int) -> None:
        self._change_sigma, self._threads = change_sigma, threads
        self._video: Video | None = None
        self._frames = 0
        self._latest_s = 0.0

    def next(self, counts: Counts, calibration: Calibration, frames: int) -> xr.Dataset:
        """Image of the next histogram; every pixel is fitted where the kept fits know less."""
        now = time.monotonic()
        video = self._video
        if video is None or video.calibration is not calibration or frames > GROWTH * self._frames:
            video = Video(calibration, change_sigma=self._change_sigma, threads=self._threads)
            self._video, self._frames = video, frames
        due = self._due(calibration.usable.shape, now)
        self._latest_s = now
        return video.next(counts, due=due)

    def _due(self, shape: tuple[int, ...], now: float) -> NDArray[np.bool_]:
        """Pixels whose turn has come since the latest picture."""
        due = np.zeros(shape, bool)
        per_s = due.size / REFRESH_S
        first, stop = int(per_s * self._latest_s), int(per_s * now)
        due.flat[np.arange(first, min(stop, first + due.size)) % due.size] = True
        return due


class _Window:
    """Sum of the newest histograms of a run, kept up to date: each is added and taken out once.

    Parameters
    ----------
    blocks : how many.
    """

    def __init__(self, blocks: int) -> None:
        self.blocks = blocks
        self.frames = 0
        self._live: deque[LiveBlock] = deque()
        self._total: Counts | None = None

    def add(self, live: LiveBlock) -> None:
        """Take a histogram in, and the oldest out."""
        if self.blocks == 1:
            self.frames, self._total = live.block.frames, _lent(live)
            return
        # one LED at a time: pictures are of the one that fires now, so steps are not summed
        if self._live and (self._live[-1].run, _step(self._live[-1])) != (live.run, _step(live)):
            while self._live:
                self._live.popleft().give_back()
            self.frames, self._total = 0, None
        self._live.append(live)
        self.frames += live.block.frames
        needed = np.uint16 if self.frames <= np.iinfo(np.uint16).max else np.uint32
        if self._total is None:
            self._total = _counts(live).astype(needed)
        else:
            self._total = self._total.astype(needed, copy=False)
            np.add(self._total, _counts(live), out=self._total)
        if len(self._live) > self.blocks:
            oldest = self._live.popleft()
            self.frames -= oldest.block.frames
            np.subtract(self._total, _counts(oldest), out=self._total)
            oldest.give_back()

    def counts(self) -> Counts:
        """The sum, in an array of its own."""
        assert self._total is not None
        return self._total if self.blocks == 1 else self._total.copy()


def _lent(live: LiveBlock) -> Counts:
    """The counts of a block that is given back when nobody holds them any more."""
    counts = _counts(live).view()
    weakref.finalize(counts, live.give_back)
    return counts


def _step(live: LiveBlock) -> int:
    return max(live.block.counts)


def _counts(live: LiveBlock) -> Counts:
    return live.block.counts[_step(live)]
