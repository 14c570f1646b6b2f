# SPDX-License-Identifier: Apache-2.0
"""What the states of an acquisition share: the rig, the run that is on, and what was counted."""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from hueflight.acquisition.delay_histogram import DelayHistogram
from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.plan import Gap, RunPlan, RunResult
from hueflight.acquisition.recorder import Recorder
from hueflight.acquisition.run import Run
from hueflight.acquisition.run_settings import RunSettings
from hueflight.acquisition.snapshot import LiveBlock, LiveSums, Snapshot
from hueflight.acquisition.states import State
from hueflight.devices.camera_controls import CameraControls, CameraTiming
from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import ScheduledIllumination
from hueflight.devices.pulse_schedule import Capacity
from hueflight.devices.rig import Connect, Rig
from hueflight.devices.simulation import Simulation
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.ingest.stream import Block
from hueflight.ingest.sums_blocks import SumsBlock
from hueflight.model.instrument import Instrument
from hueflight_protocol import ReductionRoom
from hueflight_protocol.typed_registers.camera import Capture

PUBLISH_S = 0.02  #: longest time from one snapshot to the next while pieces of the stream come
GAPS_KEPT = 100
POWER_LOST = "the camera has forgotten its run: it lost power or was reset"


@dataclass(frozen=True)
class OpenGap:
    """A gap that still lasts.

    Attributes
    ----------
    began_s : float
        Monotonic clock.
    began : str
        UTC, ISO 8601.
    reason : str
        What happened.
    """

    began_s: float
    began: str
    reason: str


class Session:
    """What the states share; only the acquisition thread changes it, requests and flags excepted.

    Parameters
    ----------
    connect : callable
        Opens the rig.
    instrument : Instrument
        The instrument that the rig should be, with the schedule that it has by default.
    settings : RunSettings
        Sizes of blocks and queues.
    live : RunPlan or None
        Run to fall back to when nothing else is asked.
    on_block : callable or None
        Receives every block.
    on_event : callable
        Receives the name and the details of what happens.
    """

    def __init__(
        self,
        connect: Connect,
        instrument: Instrument,
        settings: RunSettings,
        live: RunPlan | None,
        on_block: Callable[[LiveBlock | LiveSums], None] | None,
        on_event: Callable[[str, dict[str, Any]], None],
    ) -> None:
        self.connect, self.settings = connect, settings
        self._stated = instrument
        self.instrument = instrument  # with the schedule of the present controls
        self.on_block, self.on_event = on_block, on_event
        # set from other threads
        self.live = live
        self.controls, self.settings_wanted = CameraControls(), settings
        self.end_requested = False
        self.requests: queue.SimpleQueue[tuple[RunPlan, Future[RunResult]]] = queue.SimpleQueue()
        self._returned: queue.SimpleQueue[Block] = queue.SimpleQueue()
        # of the acquisition thread
        self.rig: Rig | None = None
        self.applied: CameraControls | None = None  # None: to no rig yet
        self.run: Run | None = None
        self.future: Future[RunResult] | None = None
        self.recorder: Recorder | None = None
        self.open_gap: OpenGap | None = None
        self.gaps: deque[Gap] = deque(maxlen=GAPS_KEPT)
        self.totals_before = RunTotals()
        self.photons_before = 0
        self.received_bytes = 0
        self.last_data_s: float | None = None
        self.kept_alive_s = 0.0
        self.connections = 0
        self.rate_hz: float | None = None
        self.timing: CameraTiming | None = None
        self.capacity: Capacity | None = None
        self.link: str = ""
        self.reduction_room: ReductionRoom | None = None
        self.simulation: Simulation | None = None
        self.failed = False
        self.label = int(time.time()) & Capture.VALUE_MAX
        self.snapshot = Snapshot(problem="looking for the camera")
        self._published: tuple[object, ...] = (None, None, None)
        self._published_s = 0.0
        self.write_delays = DelayHistogram()

    @property
    def resting_state(self) -> State:
        """The state that belongs to a rig that is open or not, and a run that is on or not."""
        if self.failed:
            return State.FAILED
        if self.rig is None:
            return State.SEARCHING if self.run is None else State.INTERRUPTED
        return State.IDLE if self.run is None else State.RUNNING

    def is_over(self, run: Run, now: float) -> bool:
        """Return whether a run has to end.

        Parameters
        ----------
        run : Run
            The run that is on.
        now : float
            Monotonic clock.

        Returns
        -------
        bool
            True if it was asked to end, has reached its end, or must make way for another.
        """
        if run.plan.live and (not self.requests.empty() or self.live != run.plan):
            return True
        wanted = self.controls_for(run.plan)
        changed = run.controls != wanted or run.instrument is not self.instrument
        if run.plan.live and changed:
            return True
        return self.end_requested or run.reached_its_end(now)

    # -- the stream ---------------------------------------------------------------------------

    def take(self, rig: Rig, run: Run, piece: bytes, now: float) -> None:
        """Count a piece of the stream, record it, and hand out the blocks that it completes.

        Parameters
        ----------
        rig : Rig
            Rig that the piece came from.
        run : Run
            The run that is on.
        piece : bytes
            Bytes of the stream.
        now : float
            Monotonic clock when they had arrived.
        """
        self.last_data_s = now
        self.received_bytes += len(piece)
        piece = run.own(piece)
        while not self._returned.empty():
            run.stream.recycle(self._returned.get())
        if self.recorder is not None:
            self.recorder.offer(piece)
        for block in run.take(piece, now, rig.camera.statistics):
            self.hand_out(block, now, run)

    def hand_out(self, block: Block | SumsBlock, now: float, run: Run) -> None:
        """Give a block to whoever looks at blocks.

        Parameters
        ----------
        block : Block or SumsBlock
            A histogram or a picture of sums of the run.
        now : float
            Monotonic clock when its last byte had arrived.
        run : Run
            The run.
        """
        about = run.plan.kind, run.label, run.instrument
        if isinstance(block, SumsBlock):
            reduction = run.controls.reduction
            if self.on_block is not None and reduction is not None:
                clock_hz = self.timing.clock_hz if self.timing is not None else 0
                self.on_block(LiveSums(block, now, *about, reduction, clock_hz))
            return
        if self.on_block is None:
            run.stream.recycle(block)
            return
        returned = self._returned
        self.on_block(LiveBlock(block, now, *about, lambda: returned.put(block)))

    # -- the camera's settings ----------------------------------------------------------------

    def controls_for(self, plan: RunPlan | None, /) -> CameraControls:
        """Return what the camera is to do in a run.

        Parameters
        ----------
        plan : RunPlan or None
            Plan of the run, None if there is none.

        Returns
        -------
        CameraControls
            The controls, with codes instead of sums if the run needs histograms.
        """
        controls = self.controls  # once: other threads change it
        if plan is None or not plan.needs_histograms:
            return controls
        return controls.with_histograms(self._stated)

    def configure(self, rig: Rig, controls: CameraControls) -> None:
        """Set camera and LEDs up; between runs only.

        Parameters
        ----------
        rig : Rig
            Rig that is set up.
        controls : CameraControls
            What the camera is to do.

        Raises
        ------
        DeviceError
            If camera or LEDs can't do it, or are gone.
        """
        settings = self.settings_wanted
        self.timing, self.simulation = rig.camera.timing, rig.camera.simulation
        self.link, self.reduction_room = rig.camera.link, rig.camera.reduction_room
        instrument, lights = controls.scheduled(self._stated), rig.illumination
        self.capacity = lights.capacity if isinstance(lights, ScheduledIllumination) else None
        self.rate_hz = rig.camera.configure(self._stated, controls).rate_hz
        if isinstance(lights, ScheduledIllumination):
            lights.load_schedule(instrument)
        elif controls.schedule is not None:
            raise DeviceError(
                f"the schedule can't be changed: illumination {lights.name!r} takes none"
            )
        self.applied, self.settings = controls, settings
        if instrument != self.instrument:
            self.instrument = instrument

    # -- gaps ---------------------------------------------------------------------------------

    def begin_gap(self, reason: str) -> None:
        """Note that the rig is gone.

        Parameters
        ----------
        reason : str
            What happened.
        """
        self.open_gap = OpenGap(time.monotonic(), _utc(), reason)

    def end_gap(self, run: Run | None, frames_lost: int | None) -> None:
        """Note that the rig is back, or that the run has ended without it.

        Parameters
        ----------
        run : Run or None
            Run that the gap belongs to.
        frames_lost : int or None
            Frames lost in it, None if nobody knows.
        """
        gap, self.open_gap = self.open_gap, None
        if gap is not None:
            seconds = time.monotonic() - gap.began_s
            self._add_gap(Gap(gap.began, _utc(), seconds, gap.reason, frames_lost), run)

    def add_gap_of_power_loss(self, run: Run) -> None:
        """Note that the camera lost its counters at an unknown time since the last data.

        Parameters
        ----------
        run : Run
            Run that the gap belongs to.
        """
        seconds = time.monotonic() - max(run.last_data_s, run.began_s)
        self._add_gap(Gap(_utc(), _utc(), seconds, POWER_LOST, None), run)

    def _add_gap(self, gap: Gap, run: Run | None) -> None:
        self.gaps.append(gap)
        if run is not None:
            run.gaps.append(gap)
        self.on_event("gap", {"seconds": round(gap.seconds, 3), "frames_lost": gap.frames_lost})

    # -- what others see ----------------------------------------------------------------------

    def report_problem(self, problem: str) -> None:
        """Show what is wrong.

        Parameters
        ----------
        problem : str
            The problem in words.
        """
        self.snapshot = replace(self.snapshot, problem=problem)

    def refresh(self) -> None:
        """Publish when something begins or ends, and now and then meanwhile: pieces are many."""
        about = (self.rig, self.run, self.recorder)
        same = all(new is old for new, old in zip(about, self._published, strict=True))
        now = time.monotonic()
        if not same or now - self._published_s > PUBLISH_S:
            self._published, self._published_s = about, now
            self.publish(self.resting_state)

    def publish(self, state: State, *, problem: str | None = None) -> None:
        """Make a new snapshot.

        Parameters
        ----------
        state : State
            State to show.
        problem : str, optional
            What is wrong in words; by default what was, or nothing while a run is on.
        """
        rig, run, recorder = self.rig, self.run, self.recorder
        if problem is None:
            problem = self.snapshot.problem if state is not State.RUNNING else ""
        totals, photons = self.totals_before, self.photons_before
        if run is not None:
            if recorder is not None:
                run.accounting.disk = recorder.lost_frames(run.delivered_in_all)
            totals, photons = totals + run.update_totals(), photons + run.photons
        self.snapshot = Snapshot(
            state=state.shown,
            problem=problem,
            rig=_described(rig),
            simulated=rig.simulated if rig is not None else self.snapshot.simulated,
            kind=run.plan.kind if run and not run.plan.live else "live" if run else "",
            run_frames=run.delivered_in_all if run else 0,
            run_limit=run.plan.frame_limit(self.instrument) if run else 0,
            run_photons=run.photons_in_all if run else 0,
            totals=totals,
            photons=photons,
            received_bytes=self.received_bytes,
            last_data_s=self.last_data_s,
            recording=str(recorder.path) if recorder else "",
            recorded_frames=recorder.frames if recorder else 0,
            recorded_bytes=recorder.size if recorder else 0,
            recorder_queue_bytes=recorder.queued_bytes if recorder else 0,
            recording_failure=recorder.failure if recorder else "",
            recording_paused=recorder.paused if recorder else False,
            stream=rig.camera.statistics if rig is not None else StreamStatistics(),
            gaps=tuple(self.gaps),
            connections=self.connections,
            rate_hz=self.rate_hz,
            timing=self.timing,
            capacity=self.capacity,
            link=self.link,
            reduction_room=self.reduction_room,
        )


def _described(rig: Rig | None) -> dict[str, str]:
    """Return a rig in words, nothing for none."""
    if rig is None:
        return {}
    identity = rig.camera.identity
    return {
        "serial": identity.serial,
        "place": identity.place,
        "firmware": identity.firmware,
        "illumination": rig.illumination.name,
    }


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
