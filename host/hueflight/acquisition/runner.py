"""Acquisition: one thread that owns the rig, runs plans, and never waits for anyone.

Whoever looks (a viewer, a recorder, a client) is handed what there is and can't hold it up. When
the rig goes away, it is looked for until it is back; the gap is marked and the run goes on.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.plan import CaptureError, Gap, RunPlan, RunResult
from hueflight.acquisition.recorder import Recorder
from hueflight.acquisition.run import Run, RunSettings
from hueflight.acquisition.snapshot import LiveBlock, Snapshot
from hueflight.acquisition.thread_priority import ThreadPriority, adopt
from hueflight.devices.errors import DeviceError, DeviceGoneError, DeviceTimeoutError
from hueflight.devices.rig import Connect, Rig
from hueflight.devices.transports.stream import StreamStatistics
from hueflight.errors import HueflightError
from hueflight.ingest.stream import Block
from hueflight.model.instrument import Instrument
from hueflight_protocol.typed_registers.camera import Capture

RECONNECT_S = 0.5
IDLE_S = 0.05
READ_S = 0.05
PUBLISH_S = 0.02
SETTLE_S = 0.3  #: after the end of a run, longest silence before its stream counts as read
SILENCE_S = 2.0  #: without a byte in a run, ask the camera whether it is still there
KEEP_ALIVE_S = 0.3
DRAIN_S = 2.0  #: longest time to read what an earlier run has left in the stream
GAPS_KEPT = 100
FORGOTTEN = "the camera has forgotten its run: it lost power or was reset"


class Acquisition:
    """Runs plans on a rig.

    Parameters
    ----------
    connect : opens the rig; called again and again while there is none.
    instrument : that the rig should be.
    settings : of blocks and queues.
    live : run to fall back to when nothing else is asked, or None to stay idle.
    on_block : given every block; must return at once.
    on_event : told what happens, as (name, details).
    """

    def __init__(
        self,
        connect: Connect,
        instrument: Instrument,
        /,
        *,
        settings: RunSettings | None = None,
        live: RunPlan | None = None,
        on_block: Callable[[LiveBlock], None] | None = None,
        on_event: Callable[[str, dict[str, Any]], None] | None = None,
    ) -> None:
        self.instrument = instrument
        self.settings = settings or RunSettings.of(instrument)
        self._connect = connect
        self._on_block = on_block
        self._on_event = on_event or (lambda name, details: None)
        self._plans: queue.SimpleQueue[tuple[RunPlan, Future[RunResult]]] = queue.SimpleQueue()
        self._live = live
        self._rig: Rig | None = None
        self._run: Run | None = None
        self._run_future: Future[RunResult] | None = None
        self._recorder: Recorder | None = None
        self._end_asked = False
        self._closing = False
        self._before = RunTotals()
        self._photons_before = 0
        self._received_before = 0
        self._gap_since: tuple[float, str, str] | None = None
        self._gaps: deque[Gap] = deque(maxlen=GAPS_KEPT)
        self._last_data_s: float | None = None
        self._kept_alive_s = 0.0
        self._connections = 0
        self._published: tuple[Rig | None, Run | None, Recorder | None] = (None, None, None)
        self._published_s = 0.0
        self._returned: queue.SimpleQueue[Block] = queue.SimpleQueue()
        self._label = int(time.time()) & Capture.VALUE_MAX
        self.snapshot = Snapshot(problem="looking for the camera")
        self._thread = threading.Thread(target=self._work, name="acquisition", daemon=True)
        self._thread.start()

    # -- from any thread ----------------------------------------------------------------------

    def run(self, plan: RunPlan, /) -> Future[RunResult]:
        """Have a plan run next; the live run makes way, another run is waited for.

        Raises
        ------
        CaptureError
            If the plan can't be.
        """
        plan.check()
        future: Future[RunResult] = Future()
        self._plans.put((plan, future))
        return future

    def set_live(self, plan: RunPlan | None, /) -> None:
        """Choose what runs when nothing else is asked; None to stay idle."""
        self._live = plan

    def stop(self) -> None:
        """End the present run as soon as its stream is read; a live run begins again."""
        self._end_asked = True

    def close(self, *, timeout_s: float = 20.0) -> None:
        """End the run, finish the recording, leave the LEDs dark."""
        self._closing = True
        self._thread.join(timeout_s)

    # -- the acquisition thread ---------------------------------------------------------------

    def _work(self) -> None:
        self._on_event("acquisition", {"scheduled": adopt(ThreadPriority.ACQUISITION)})
        while not self._closing:
            try:
                self._step()
            except DeviceError as error:
                self._lost(error)
            except HueflightError as error:
                self._fail_run(str(error))
            self._refresh()
        try:
            if self._run is not None:
                self._finish("the program ended")
        except HueflightError as error:
            self._fail_run(str(error))
        if self._rig is not None:
            self._rig.close()
        self._cancel_plans()
        self._publish(state="disconnected", problem="closed")

    def _step(self) -> None:
        run = self._run
        if self._rig is None:
            if run is not None and self._is_over(run, time.monotonic()):
                self._finish(self.snapshot.problem)
            elif not self._try_connect():
                self._pause(RECONNECT_S)
            return
        if run is None:
            if not self._begin_next():
                self._pause(IDLE_S)
            return
        piece = self._rig.camera.read(READ_S)
        now = time.monotonic()
        self._keep_alive(now)
        if piece:
            self._take(run, piece, now)
        elif now - max(run.last_data_s, run.began_s) > run.silence_s(SILENCE_S):
            self._ask_after(run, now)
        if run.ended or self._is_over(run, now):
            self._finish("")

    def _pause(self, seconds: float) -> None:
        time.sleep(seconds)

    def _is_over(self, run: Run, now: float) -> bool:
        """Whether the run was asked to end, has reached its end, or must make way."""
        if run.plan.live and (not self._plans.empty() or self._live != run.plan):
            return True
        return self._end_asked or run.reached_its_end(now)

    def _try_connect(self) -> bool:
        try:
            rig = self._connect()
        except DeviceError as error:
            self.snapshot = replace(self.snapshot, problem=str(error))
            return False
        try:
            self._settle_orphan(rig)
            if rig.camera.running():
                rig.camera.stop(abort=True)
            chosen = rig.camera.configure(self.instrument)
        except DeviceError as error:
            rig.close()
            self.snapshot = replace(self.snapshot, problem=str(error))
            return False
        self._rig = rig
        self._connections += 1
        self._publish(problem="")  # the first run may take long to prepare
        identity = rig.camera.identity
        self._on_event(
            "connected",
            {
                "serial": identity.serial,
                "place": identity.place,
                "frame_rate_hz": round(chosen.rate_hz, 1),
            },
        )
        run = self._run
        if run is not None:
            self._resume(run)
        return True

    def _resume(self, run: Run) -> None:
        """Go on with a run that the loss of the rig has interrupted."""
        for block in run.finish():
            self._hand_out(block, time.monotonic(), run)
        run.ledger.disk = 0  # booked when the recording is closed
        self._before += run.close_books()
        self._photons_before += run.photons
        self._run = run.successor()
        self._label = self._run.label
        self._start_camera(self._run)

    def _settle_orphan(self, rig: Rig) -> None:
        """Ask a camera that is back what it did meanwhile, and close the gap."""
        if self._gap_since is None:
            return
        run = self._run
        lost: int | None = None
        if run is not None and rig.camera.run_label() == run.label:
            # a link that goes away amid a start may leave the run's label beside the counters of
            # the run before, which are booked already
            begun = run.started or rig.camera.running()
            lost = run.settle_from_registers(rig.camera, away=True) if begun else 0
        self._end_gap(run, lost)

    def _end_gap(self, run: Run | None, lost: int | None) -> None:
        if self._gap_since is None:
            return
        since, started, reason = self._gap_since
        self._gap_since = None
        self._add_gap(Gap(started, _utc(), time.monotonic() - since, reason, lost), run)

    def _add_gap(self, gap: Gap, run: Run | None) -> None:
        self._gaps.append(gap)
        if run is not None:
            run.gaps.append(gap)
        self._on_event("gap", {"seconds": round(gap.seconds, 3), "frames_lost": gap.frames_lost})

    def _begin_next(self) -> bool:
        self._end_asked = False  # before the plan counts as running: a later stop is meant for it
        if not self._plans.empty():
            plan, future = self._plans.get()
            if not future.set_running_or_notify_cancel():
                return True
        elif self._live is not None:
            plan, future = self._live, None
        else:
            return False
        try:
            self._begin(plan, future)
        except DeviceError as error:
            if future is not None:
                future.set_exception(CaptureError(str(error)))
            self._run = self._run_future = None
            self._close_recorder()
            if isinstance(error, DeviceGoneError | DeviceTimeoutError):
                raise
            self._live = None if plan.live else self._live
            self.snapshot = replace(self.snapshot, problem=str(error))
        except HueflightError as error:
            self._run = self._run_future = None
            self._close_recorder()
            if future is None:
                raise
            future.set_exception(error)
        return True

    def _begin(self, plan: RunPlan, future: Future[RunResult] | None) -> None:
        assert self._rig is not None
        self._rig.illumination.prepare(plan.kind, plan.frames)
        if plan.path is not None:
            metadata = dict(plan.metadata) | {
                "capture": plan.kind, "simulated": str(self._rig.simulated).lower()
            }  # fmt: skip
            self._recorder = Recorder(
                replace(plan, metadata=metadata), self.instrument,
                queue_bytes=self.settings.recorder_queue_bytes,
                min_free_bytes=self.settings.min_free_bytes,
            )  # fmt: skip
        self._label = self._label + 1 & Capture.VALUE_MAX
        self._run = Run(plan, self.instrument, self.settings, label=self._label)
        self._run_future = future
        self._start_camera(self._run)
        self._on_event("run started", {"kind": plan.kind, "recording": str(plan.path or "")})

    def _start_camera(self, run: Run) -> None:
        """Begin the run; what the link still holds of an earlier one is mostly read before."""
        assert self._rig is not None
        camera = self._rig.camera
        if camera.running():
            camera.stop(abort=True)
        camera.listen(rate_hz=self.settings.rate_hz)
        deadline = time.monotonic() + DRAIN_S
        while camera.read(0.02) and time.monotonic() < deadline:
            pass
        run.began_s = time.monotonic()
        run.stalled_before_s = camera.statistics.stalled_s
        camera.start(capture=run.label, frame_limit=run.frames_left())
        run.started = True

    def _take(self, run: Run, piece: bytes, now: float) -> None:
        self._last_data_s = now
        self._received_before += len(piece)
        piece = run.own(piece)
        while not self._returned.empty():
            run.stream.recycle(self._returned.get())
        if self._recorder is not None:
            self._recorder.offer(piece)
        assert self._rig is not None
        for block in run.take(piece, now, self._rig.camera.statistics):
            self._hand_out(block, now, run)

    def _hand_out(self, block: Block, now: float, run: Run) -> None:
        if self._on_block is None:
            run.stream.recycle(block)
            return
        returned = self._returned
        self._on_block(LiveBlock(block, now, run.plan.kind, run.label, lambda: returned.put(block)))

    def _ask_after(self, run: Run, now: float) -> None:
        """A run is on and nothing comes: is the camera there, does it still run?"""
        assert self._rig is not None
        run.last_data_s = now
        camera = self._rig.camera
        if camera.running():
            return
        if camera.run_label() == run.label:
            run.ended = True  # it ended by itself, and the event that says so was lost
        else:
            raise DeviceGoneError(f"{camera.identity.place}: {FORGOTTEN}")

    def _keep_alive(self, now: float) -> None:
        if self._rig is not None and now - self._kept_alive_s > KEEP_ALIVE_S:
            self._kept_alive_s = now
            self._rig.illumination.keep_alive()

    def _finish(self, failure: str) -> None:
        """End the run: stop the camera, read what is under way, close books and recording."""
        run, rig = self._run, self._rig
        assert run is not None
        self._end_asked = False
        if rig is None:
            self._end_gap(run, None)  # what the camera has done since will never be known
        else:
            if not run.ended:
                rig.camera.stop()
            quiet_since = time.monotonic()
            while time.monotonic() - quiet_since < SETTLE_S:
                piece = rig.camera.read(READ_S)
                if piece:
                    quiet_since = time.monotonic()
                    self._take(run, piece, quiet_since)
                elif run.ended:
                    break
            if rig.camera.run_label() == run.label:
                run.settle_from_registers(rig.camera, away=False)
            else:
                seconds = time.monotonic() - max(run.last_data_s, run.began_s)
                self._add_gap(Gap(_utc(), _utc(), seconds, FORGOTTEN, None), run)
        for block in run.finish():
            self._hand_out(block, time.monotonic(), run)
        self._conclude(run, failure)

    def _conclude(self, run: Run, failure: str) -> None:
        """Book the run, finish its recording, and tell whoever asked for it."""
        recorder = self._recorder
        self._close_recorder()
        if recorder is not None:
            run.ledger.disk = max(0, run.delivered_in_all - recorder.frames)
            failure = failure or recorder.failure
        totals = run.close_books()
        self._before += totals
        self._photons_before += run.photons
        result = run.result(failure, simulated=self.snapshot.simulated)
        if recorder is not None:
            result = replace(result, recorded_frames=recorder.frames, recorded_bytes=recorder.size)
        if run.watch is not None:
            run.watch.close()
        self._run = None
        future, self._run_future = self._run_future, None
        self._on_event(
            "run ended",
            {"kind": run.plan.kind, "frames": result.totals.delivered, "failure": failure}
            | {f"lost_{name}": n for name, n in result.totals.losses.as_dict().items() if n},
        )
        if future is not None:
            future.set_result(result)

    def _lost(self, error: DeviceError) -> None:
        """The rig is gone: keep the run open and look for the rig."""
        rig, self._rig = self._rig, None
        if rig is not None:
            rig.close()
        self._gap_since = (time.monotonic(), _utc(), str(error))
        self.snapshot = replace(self.snapshot, problem=str(error))
        self._on_event("disconnected", {"reason": str(error)})

    def _fail_run(self, reason: str) -> None:
        """The run can't go on for a reason of its own, such as frames of another geometry."""
        self._on_event("run failed", {"reason": reason})
        run = self._run
        if run is not None:
            if run.plan.live:
                self._live = None
            self._conclude(run, reason)
        self.snapshot = replace(self.snapshot, problem=reason)

    def _close_recorder(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()

    def _cancel_plans(self) -> None:
        while not self._plans.empty():
            _, future = self._plans.get()
            if future.set_running_or_notify_cancel():
                future.set_exception(CaptureError("the program ended before the run began"))

    def _refresh(self) -> None:
        """Publish when something begins or ends, and now and then meanwhile: pieces are many."""
        about = (self._rig, self._run, self._recorder)
        same = all(new is old for new, old in zip(about, self._published, strict=True))
        now = time.monotonic()
        if not same or now - self._published_s > PUBLISH_S:
            self._published, self._published_s = about, now
            self._publish()

    def _publish(self, *, state: str | None = None, problem: str | None = None) -> None:
        rig, run, recorder = self._rig, self._run, self._recorder
        if state is None:
            state = "disconnected" if rig is None else "running" if run else "idle"
        if problem is None:
            problem = self.snapshot.problem if state != "running" else ""
        totals, photons = self._before, self._photons_before
        if run is not None:
            if recorder is not None:
                run.ledger.disk = recorder.lost_frames(run.delivered_in_all)
            totals, photons = totals + run.close_books(), photons + run.photons
        identity = rig.camera.identity if rig is not None else None
        self.snapshot = Snapshot(
            state=state,
            problem=problem,
            rig={}
            if identity is None
            else {
                "serial": identity.serial,
                "place": identity.place,
                "firmware": identity.firmware,
                "lights": rig.illumination.name if rig else "",
            },
            simulated=rig.simulated if rig is not None else self.snapshot.simulated,
            kind=run.plan.kind if run and not run.plan.live else "live" if run else "",
            run_frames=run.delivered_in_all if run else 0,
            run_limit=run.plan.frame_limit(self.instrument) if run else 0,
            run_photons=run.photons_in_all if run else 0,
            totals=totals,
            photons=photons,
            received_bytes=self._received_before,
            last_data_s=self._last_data_s,
            recording=str(recorder.path) if recorder else "",
            recorded_frames=recorder.frames if recorder else 0,
            recorded_bytes=recorder.size if recorder else 0,
            recorder_queue_bytes=recorder.queued_bytes if recorder else 0,
            recording_failure=recorder.failure if recorder else "",
            stream=rig.camera.statistics if rig is not None else StreamStatistics(),
            gaps=tuple(self._gaps),
            connections=self._connections,
        )


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
