# SPDX-License-Identifier: Apache-2.0
"""The state in which nothing runs: begin the run that was asked for, or the live run."""

from __future__ import annotations

import time
from concurrent.futures import Future
from dataclasses import replace

from hueflight.acquisition.plan import CaptureError, RunPlan, RunResult
from hueflight.acquisition.recorder import Recorder
from hueflight.acquisition.run import Run
from hueflight.acquisition.session import Session
from hueflight.acquisition.states import State
from hueflight.acquisition.sums_reduction import attachments_of
from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError, DeviceGoneError, DeviceTimeoutError
from hueflight.devices.rig import Rig
from hueflight.errors import HueflightError
from hueflight.recording.sums_reader import CLOCK
from hueflight_protocol.typed_registers.camera import Capture

IDLE_S = 0.05
DRAIN_S = 2.0  #: longest time to read what an earlier run has left in the stream
_DRAIN_READ_S = 0.02


def begin_next(session: Session) -> State:
    """Begin the next run if there is one: the work of `State.IDLE`.

    Parameters
    ----------
    session : Session
        With a rig, without a run.

    Returns
    -------
    State
        The state that follows.

    Raises
    ------
    DeviceError
        If the rig is gone.
    HueflightError
        If the live run can't be begun.
    """
    assert session.rig is not None
    # before the plan counts as running: a stop that is asked for later is meant for this run
    session.end_requested = False
    if not session.requests.empty():
        plan, future = session.requests.get()
        if future.set_running_or_notify_cancel():
            _try_to_begin(session, session.rig, plan, future)
    elif session.live is not None:
        _try_to_begin(session, session.rig, session.live, None)
    else:
        time.sleep(IDLE_S)
    return session.resting_state


def start_camera(camera: Camera, run: Run, /, *, rate_hz: float) -> None:
    """Begin a run on the camera, having read most of what the link holds of an earlier one.

    Parameters
    ----------
    camera : Camera
        The camera, which may still be in an earlier run.
    run : Run
        The run to begin.
    rate_hz : float
        Frames per second to expect.
    """
    if camera.running():
        camera.stop(abort=True)
    camera.listen(rate_hz=rate_hz)
    deadline = time.monotonic() + DRAIN_S
    while camera.read(_DRAIN_READ_S) and time.monotonic() < deadline:
        pass
    run.began_s = time.monotonic()
    run.stalled_before_s = camera.statistics.stalled_s
    camera.start(capture=run.label, frame_limit=run.frames_left())
    run.started = True


def _try_to_begin(
    session: Session, rig: Rig, plan: RunPlan, future: Future[RunResult] | None
) -> None:
    """Begin a run; tell whoever asked for it if that does not work."""
    try:
        _begin(session, rig, plan, future)
    except HueflightError as error:
        session.run = session.future = None
        recorder, session.recorder = session.recorder, None
        if recorder is not None:
            recorder.close()
        is_device_error = isinstance(error, DeviceError)
        if future is not None:
            future.set_exception(CaptureError(str(error)) if is_device_error else error)
        if isinstance(error, DeviceGoneError | DeviceTimeoutError):
            raise
        if is_device_error:
            if plan.live:
                session.live = None
            session.report_problem(str(error))
        elif future is None:
            raise


def _begin(session: Session, rig: Rig, plan: RunPlan, future: Future[RunResult] | None) -> None:
    controls = session.controls_for(plan)
    if session.applied != controls:
        session.configure(rig, controls)
    reduction = controls.reduction if controls.sends_sums_only else None
    rig.illumination.prepare(plan.kind, plan.frames)
    if plan.path is not None:
        about = {"capture": plan.kind, "simulated": str(rig.simulated).lower()}
        if reduction is not None and session.timing is not None:
            about[CLOCK] = str(session.timing.clock_hz)
        session.recorder = Recorder(
            replace(
                plan,
                metadata=dict(plan.metadata) | about,
                attachments=dict(plan.attachments) | attachments_of(reduction, session.instrument),
            ),
            session.instrument,
            queue_bytes=session.settings.recorder_queue_bytes,
            min_free_bytes=session.settings.min_free_bytes,
            on_event=session.on_event,
            write_delays=session.write_delays,
            reduced=reduction is not None,
        )
    session.label = session.label + 1 & Capture.VALUE_MAX
    session.run = Run(
        plan, session.instrument, session.settings, label=session.label, controls=controls
    )
    session.future = future
    start_camera(rig.camera, session.run, rate_hz=session.settings.rate_hz)
    session.on_event("run started", {"kind": plan.kind, "recording": str(plan.path or "")})
