# SPDX-License-Identifier: Apache-2.0
"""One run while it is on: its stream, its frame accounting, its end."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.frame_accounting import FrameAccounting, RunTotals
from hueflight.acquisition.plan import Gap, RunPlan, RunResult
from hueflight.acquisition.precision_stop import PrecisionMonitor
from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.stale_data_filter import StaleDataFilter
from hueflight.devices.camera import DEFAULT_CONTROLS, Camera
from hueflight.devices.camera_controls import CameraControls
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.ingest.picture_totals import PictureTotals, holds_sums
from hueflight.ingest.report import IngestReport
from hueflight.ingest.stream import Block, HistogramStream
from hueflight.ingest.sums_blocks import SumsBlock, SumsBlocks
from hueflight.model.instrument import Instrument
from hueflight_protocol import Event, EventCode, decode_packet
from hueflight_protocol.typed_registers.camera import Capture

_FRAMES_TO_BE_LATE = 20


class Run:
    """A run that is on.

    Parameters
    ----------
    plan : RunPlan
        What the run is for and when it ends.
    instrument : Instrument
        The instrument that takes the frames.
    settings : RunSettings
        Sizes of blocks.
    label : int
        The run's number in every packet.
    precision : PrecisionMonitor, optional
        Monitor of the run that this one goes on with; by default a new one, if the plan needs it.
    controls : CameraControls, optional
        What the camera does in this run.

    Attributes
    ----------
    controls : CameraControls
        What the camera does in this run.
    instrument : Instrument
        The instrument that takes the frames.
    stream : HistogramStream
        Counts the run's packets.
    pictures : PictureTotals
        Pictures of sums of the run.
    accounting : FrameAccounting
        Frames delivered and lost.
    started, ended : bool
        True if the camera has answered that the run is on, or has said that it is over.
    began_s, last_data_s : float
        Monotonic clock.
    first_began : str
        UTC in ISO 8601 when the run began, gaps or not.
    gaps : list of Gap
        Times in which the camera was away.
    precision : PrecisionMonitor or None
        Knows how precise the result is, where the plan ends by it.
    """

    def __init__(
        self,
        plan: RunPlan,
        instrument: Instrument,
        settings: RunSettings,
        *,
        label: int,
        precision: PrecisionMonitor | None = None,
        controls: CameraControls = DEFAULT_CONTROLS,
    ) -> None:
        self.plan, self.label, self.controls = plan, label, controls
        self._reduced = controls.sends_sums_only
        self.pictures = PictureTotals()
        self._sums = SumsBlocks()
        self._stale_data_filter = StaleDataFilter(label)
        self.instrument, self._settings = instrument, settings
        by_step = plan.kind == "bands"
        self.stream = HistogramStream(
            instrument,
            block_frames=settings.block_frames,
            by_step=by_step,
            threads=settings.threads,
        )
        self.accounting = FrameAccounting()
        self.started = self.ended = False
        self.exposed_at_end: int | None = None
        self.began_s = self.first_began_s = time.monotonic()
        self.first_began = datetime.now(UTC).isoformat(timespec="milliseconds")
        self.last_data_s = 0.0
        self.stalled_before_s = 0.0
        self.gaps: list[Gap] = []
        self.precision = precision
        if plan.precision_stop is not None and precision is None:
            self.precision = PrecisionMonitor(plan.precision_stop)
        self._kept: dict[int, NDArray[np.uint32]] = {}
        self._before = RunTotals()  # of the parts before the camera went away
        self._photons_before = 0
        self._statistics = StreamStatistics()
        self._exposed = 0

    def successor(self) -> Run:
        """Return the same run after a gap, with a stream and frame accounting of its own.

        Returns
        -------
        Run
            Goes on where this one ended.
        """
        label = self.label + 1 & Capture.VALUE_MAX
        other = Run(
            self.plan, self.instrument, self._settings, label=label, precision=self.precision,
            controls=self.controls,
        )  # fmt: skip
        other.gaps = self.gaps
        other._kept = self._kept
        other._before = self._before + self.totals
        other._photons_before = self.photons_in_all
        other.first_began_s, other.first_began = self.first_began_s, self.first_began
        return other

    # -- the stream ---------------------------------------------------------------------------

    def own(self, piece: bytes, /) -> bytes:
        """Leave out what belongs to an earlier run.

        Parameters
        ----------
        piece : bytes
            Piece of the stream.

        Returns
        -------
        bytes
            What of it, and of earlier pieces, belongs to this run.
        """
        return self._stale_data_filter.cut(piece)

    def take(
        self, piece: bytes, now: float, statistics: StreamStatistics
    ) -> list[Block] | list[SumsBlock]:
        """Count a piece of the run's own stream.

        Parameters
        ----------
        piece : bytes
            Piece of the stream, as `own` returns it.
        now : float
            Monotonic clock when it had arrived.
        statistics : StreamStatistics
            Totals of the stream it came from.

        Returns
        -------
        list of Block or list of SumsBlock
            The histograms that it completes, or the pictures of sums if the camera sends no codes.
        """
        self.last_data_s = now
        self._statistics = statistics
        blocks = self.stream.feed(piece)
        pictures: list[SumsBlock] = []
        for packet in self.stream.take_others():
            if holds_sums(packet):
                self.pictures.feed(packet)
                if self._reduced:
                    pictures += self._sums.feed(packet)
            else:
                self._read_event(packet)
        for block in blocks:
            self._account(block)
        return pictures if self._reduced else blocks

    def _read_event(self, packet: bytes) -> None:
        content = decode_packet(packet)
        if not isinstance(content, Event) or content.header.capture != self.label:
            return
        if content.code == EventCode.SENSOR_FAULT:
            self.accounting.sensor_fault(content.count)
        elif content.code == EventCode.RUN_STOPPED:
            self.ended = True
            self.exposed_at_end = content.value

    def _account(self, block: Block) -> None:
        self._exposed = block.last_frame + 1
        self.accounting.update(block.report, self._exposed, stalled_s=self._stalled_s)
        self._keep(block)

    @property
    def _stalled_s(self) -> float:
        return self._statistics.stalled_s - self.stalled_before_s

    def finish(self) -> list[Block] | list[SumsBlock]:
        """Count what is left, after the last piece of the stream.

        Returns
        -------
        list of Block or list of SumsBlock
            The last histogram, if frames are left, or the last picture of sums, if its end is lost.
        """
        blocks = self.stream.finish()
        for block in blocks:
            self._keep(block)
        if self._reduced:
            return self._sums.finish()
        return [block for block in blocks if block.frames]

    def _keep(self, block: Block) -> None:
        if self.precision is not None and block.frames:
            self.precision.add(block.histogram, block.frames)
        if not self.plan.keep or not block.frames:
            return
        for step, counts in block.counts.items():
            if step not in self._kept:
                self._kept[step] = np.zeros(counts.shape, np.uint32)
            self._kept[step] += counts

    @property
    def report(self) -> IngestReport:
        """Totals of the stream; where the camera sends sums, of the frames behind them."""
        report = self.stream.report
        if not self._reduced:
            return report
        found = self.pictures
        return replace(report, frames=found.frames, photons=found.photons, dropped=found.missed)

    # -- the end ------------------------------------------------------------------------------

    def reached_its_end(self, now: float) -> bool:
        """Return whether a limit of the plan is reached.

        Parameters
        ----------
        now : float
            Monotonic clock.

        Returns
        -------
        bool
            True if the run is to end.
        """
        plan = self.plan
        if plan.seconds is not None and now - self.first_began_s >= plan.seconds:
            return True
        if self.precision is not None and self.precision.poll():
            return True
        if plan.photons_per_pixel is not None:
            pixels = self.instrument.sensor.rows * self.instrument.sensor.cols
            return self.photons_in_all / pixels >= plan.photons_per_pixel
        limit = plan.frame_limit(self.instrument)
        return bool(limit and self._before.exposed and self._before.exposed >= limit)

    def frames_left(self) -> int:
        """Return how many frames are still to be taken.

        Returns
        -------
        int
            Number of frames, 0 for no limit.
        """
        limit = self.plan.frame_limit(self.instrument)
        return max(1, limit - self._before.exposed) if limit else 0

    def silence_s(self, least: float) -> float:
        """Return how long the stream may be silent before something is wrong.

        Parameters
        ----------
        least : float
            Shortest time for any frame rate, in seconds.

        Returns
        -------
        float
            Time in seconds.
        """
        return max(least, _FRAMES_TO_BE_LATE / self._settings.rate_hz)

    def reconcile_with_camera(self, camera: Camera, *, away: bool) -> int:
        """Compare the frame accounting with what the camera has counted in this run.

        Parameters
        ----------
        camera : Camera
            The camera, which still has the counters of this run.
        away : bool
            True if the link was gone meanwhile; frames dropped since are lost to the link.

        Returns
        -------
        int
            Number of frames whose loss only the camera knew of.
        """
        if away:
            camera.stop(abort=True)
        counted = camera.counters()
        exposed = counted.frames_sent + counted.frames_dropped + counted.frames_aborted
        before = self.accounting.totals.losses.undelivered
        self._exposed = exposed
        self.accounting.reconcile(
            self.report,
            exposed=exposed,
            dropped=counted.frames_dropped,
            stalled_s=self._stalled_s,
            away=away,
        )
        return self.accounting.totals.losses.undelivered - before

    def update_totals(self) -> RunTotals:
        """Account for every frame that is known of.

        Returns
        -------
        RunTotals
            Totals of this part of the run, after its last gap.
        """
        report = self.report
        known = report.frames + report.aborted + report.dropped + report.dropped_before
        exposed = max(self._exposed, known, self.exposed_at_end or 0)
        return self.accounting.update(report, exposed, stalled_s=self._stalled_s)

    @property
    def totals(self) -> RunTotals:
        """Totals when they were last updated, of the part after the last gap."""
        return self.accounting.totals

    @property
    def photons(self) -> int:
        """Number of photons detected since the last gap."""
        return self.report.photons

    @property
    def photons_in_all(self) -> int:
        """Number of photons detected in the whole run."""
        return self._photons_before + self.photons

    @property
    def delivered_in_all(self) -> int:
        """Number of frames delivered in the whole run."""
        return self._before.delivered + self.report.frames

    def result(self, failure: str, *, simulated: bool) -> RunResult:
        """Return the run's result, including gaps.

        Parameters
        ----------
        failure : str
            Why the run ended before its time, empty if it did not.
        simulated : bool
            True if the photons are simulated.

        Returns
        -------
        RunResult
            Totals, histograms and gaps.
        """
        totals = self._before + self.totals
        return RunResult(
            plan=self.plan,
            totals=totals,
            photons=self.photons_in_all,
            histograms={step: self._kept[step] for step in sorted(self._kept)},
            simulated=simulated,
            gaps=tuple(self.gaps),
            share_known=None if self.precision is None else self.precision.share,
            failure=failure,
            started=self.first_began,
            seconds=time.monotonic() - self.first_began_s,
        )
