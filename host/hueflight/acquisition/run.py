"""One run while it is on: its stream, its books, its end."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.frame_accounting import FrameAccounting, RunTotals
from hueflight.acquisition.plan import Gap, RunPlan, RunResult
from hueflight.acquisition.precision_stop import PrecisionMonitor
from hueflight.acquisition.recorder import MIN_FREE_BYTES, QUEUE_BYTES
from hueflight.acquisition.stale_data_filter import StaleDataFilter
from hueflight.devices.camera import Camera
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.ingest.stream import Block, HistogramStream
from hueflight.model.instrument import Instrument
from hueflight_protocol import Event, EventCode, decode_packet
from hueflight_protocol.typed_registers.camera import Capture

LIVE_FRAMES = 480  #: behind each live picture at least, as far as the picture rate allows
PICTURES_HZ = 30.0
SLOW_PICTURES_HZ = 10.0
_FRAMES_TO_BE_LATE = 20


@dataclass(frozen=True)
class RunSettings:
    """How a stream is cut into histograms, and how much may wait.

    Attributes
    ----------
    rate_hz : frames per second to expect.
    block_frames : frames from one live histogram to the next.
    window_blocks : each live picture is of the sum of so many.
    threads : that count photons.
    recorder_queue_bytes, min_free_bytes : see `Recorder`.
    """

    rate_hz: float
    block_frames: int
    window_blocks: int = 1
    threads: int = 1
    recorder_queue_bytes: int = QUEUE_BYTES
    min_free_bytes: int = MIN_FREE_BYTES

    @classmethod
    def of(
        cls,
        instrument: Instrument,
        /,
        *,
        pictures_hz: float | None = None,
        picture_frames: int | None = None,
    ) -> RunSettings:
        """Settings that suit an instrument's frame rate.

        Parameters
        ----------
        pictures_hz : live histograms per second; by default 30, or 10 where so few frames come
            that pictures overlap.
        picture_frames : frames behind each picture; by default all since the one before, and at
            least 480.
        """
        rate = instrument.sensor.frame_rate_hz or 1000.0
        if pictures_hz is None:
            few = rate / PICTURES_HZ < LIVE_FRAMES
            pictures_hz = SLOW_PICTURES_HZ if few else PICTURES_HZ
        block = max(1, round(rate / pictures_hz))
        wanted = picture_frames or max(LIVE_FRAMES, block)
        return cls(rate, block, max(1, round(wanted / block)))


class Run:
    """A run that is on.

    Attributes
    ----------
    label : the run's `capture` number in every packet.
    started : the camera has answered that the run is on.
    ended : the camera has said that the run is over.
    began_s, last_data_s : monotonic clock.
    gaps : times in which the camera was away.
    watch : on what is known, where the plan ends by it.
    """

    def __init__(
        self,
        plan: RunPlan,
        instrument: Instrument,
        settings: RunSettings,
        *,
        label: int,
        watch: PrecisionMonitor | None = None,
    ) -> None:
        self.plan, self.label = plan, label
        self._beginning = StaleDataFilter(label)
        self._instrument, self._settings = instrument, settings
        by_step = plan.kind == "bands"
        self.stream = HistogramStream(
            instrument,
            block_frames=settings.block_frames,
            by_step=by_step,
            threads=settings.threads,
        )
        self.ledger = FrameAccounting()
        self.started = self.ended = False
        self.exposed_at_end: int | None = None
        self.began_s = self.first_began_s = time.monotonic()
        self.last_data_s = 0.0
        self.stalled_before_s = 0.0
        self.gaps: list[Gap] = []
        self.watch = (
            PrecisionMonitor(plan.until) if plan.until is not None and watch is None else watch
        )
        self._kept: dict[int, NDArray[np.uint32]] = {}
        self._before = RunTotals()  # of the parts before the camera went away
        self._photons_before = 0
        self._statistics = StreamStatistics()
        self._exposed = 0

    def successor(self) -> Run:
        """The same run after a gap, with a stream and books of its own."""
        label = self.label + 1 & Capture.VALUE_MAX
        other = Run(self.plan, self._instrument, self._settings, label=label, watch=self.watch)
        other.gaps = self.gaps
        other._kept = self._kept
        other._before = self._before + self.totals
        other._photons_before = self.photons_in_all
        other.first_began_s = self.first_began_s
        return other

    # -- the stream ---------------------------------------------------------------------------

    def own(self, piece: bytes, /) -> bytes:
        """What of a piece of the stream belongs to this run."""
        return self._beginning.cut(piece)

    def take(self, piece: bytes, now: float, statistics: StreamStatistics) -> list[Block]:
        """Count a piece of the run's own stream; return the histograms that it completes."""
        self.last_data_s = now
        self._statistics = statistics
        blocks = self.stream.feed(piece)
        for packet in self.stream.take_others():
            self._listen(packet)
        for block in blocks:
            self._book(block)
        return blocks

    def _listen(self, packet: bytes) -> None:
        content = decode_packet(packet)
        if not isinstance(content, Event) or content.header.capture != self.label:
            return
        if content.code == EventCode.SENSOR_FAULT:
            self.ledger.sensor_fault(content.count)
        elif content.code == EventCode.RUN_STOPPED:
            self.ended = True
            self.exposed_at_end = content.value

    def _book(self, block: Block) -> None:
        self._exposed = block.last_frame + 1
        self.ledger.update(block.report, self._exposed, stalled_s=self._stalled_s)
        self._keep(block)

    @property
    def _stalled_s(self) -> float:
        return self._statistics.stalled_s - self.stalled_before_s

    def finish(self) -> list[Block]:
        """Say that nothing more comes; return the last histogram, if frames are left."""
        blocks = self.stream.finish()
        for block in blocks:
            self._keep(block)
        return [block for block in blocks if block.frames]

    def _keep(self, block: Block) -> None:
        if self.watch is not None and block.frames:
            self.watch.add(block.histogram, block.frames)
        if not self.plan.keep or not block.frames:
            return
        for step, counts in block.counts.items():
            if step not in self._kept:
                self._kept[step] = np.zeros(counts.shape, np.uint32)
            self._kept[step] += counts

    # -- the end ------------------------------------------------------------------------------

    def reached_its_end(self, now: float) -> bool:
        """Whether a stop rule of the plan applies."""
        plan = self.plan
        if plan.seconds is not None and now - self.first_began_s >= plan.seconds:
            return True
        if self.watch is not None and self.watch.poll():
            return True
        if plan.photons_per_pixel is not None:
            pixels = self._instrument.sensor.rows * self._instrument.sensor.cols
            return self.photons_in_all / pixels >= plan.photons_per_pixel
        limit = plan.frame_limit(self._instrument)
        return bool(limit and self._before.exposed and self._before.exposed >= limit)

    def frames_left(self) -> int:
        """Frames still to be taken, 0 for no limit."""
        limit = self.plan.frame_limit(self._instrument)
        return max(1, limit - self._before.exposed) if limit else 0

    def silence_s(self, least: float) -> float:
        """How long the stream may be silent before something is wrong."""
        return max(least, _FRAMES_TO_BE_LATE / self._settings.rate_hz)

    def settle_from_registers(self, camera: Camera, *, away: bool) -> int:
        """Close the books with what the camera has counted; return frames lost at the end.

        Parameters
        ----------
        away : the link was gone meanwhile: what the camera dropped, it dropped for that.
        """
        if away:
            camera.stop(abort=True)
        counted = camera.counters()
        exposed = counted.frames_sent + counted.frames_dropped + counted.frames_aborted
        before = self.ledger.totals.losses.undelivered
        self._exposed = exposed
        self.ledger.settle(
            self.stream.report,
            exposed=exposed,
            dropped=counted.frames_dropped,
            stalled_s=self._stalled_s,
            away=away,
        )
        return self.ledger.totals.losses.undelivered - before

    def close_books(self) -> RunTotals:
        """Totals up to now: of this part of the run, after its last gap."""
        report = self.stream.report
        known = report.frames + report.aborted + report.dropped + report.dropped_before
        exposed = max(self._exposed, known)
        return self.ledger.update(report, exposed, stalled_s=self._stalled_s)

    @property
    def totals(self) -> RunTotals:
        """As booked last."""
        return self.ledger.totals

    @property
    def photons(self) -> int:
        """Since the last gap."""
        return self.stream.report.photons

    @property
    def photons_in_all(self) -> int:
        """Of the whole run."""
        return self._photons_before + self.photons

    @property
    def delivered_in_all(self) -> int:
        """Frames of the whole run."""
        return self._before.delivered + self.stream.report.frames

    def result(self, failure: str, *, simulated: bool) -> RunResult:
        """What came of it, gaps included."""
        totals = self._before + self.totals
        return RunResult(
            plan=self.plan,
            totals=totals,
            photons=self.photons_in_all,
            histograms={step: self._kept[step] for step in sorted(self._kept)},
            simulated=simulated,
            gaps=tuple(self.gaps),
            share_known=None if self.watch is None else self.watch.share,
            failure=failure,
        )
