# SPDX-License-Identifier: Apache-2.0
"""The state in which a run ends: stop the camera, read the rest, account for every frame."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace

from hueflight.acquisition.plan import CaptureError
from hueflight.acquisition.run import Run
from hueflight.acquisition.running import READ_S
from hueflight.acquisition.session import Session
from hueflight.acquisition.states import State
from hueflight.devices.rig import Rig

#: longest silence after which a stream counts as read that does not say that its run is over; a
#: busy machine may bring nothing for long, and what comes later would count as lost
SETTLE_S = 2.0


def end_run(session: Session) -> State:
    """End the run: the work of `State.ENDING`.

    Parameters
    ----------
    session : Session
        With a run; the rig may be gone.

    Returns
    -------
    State
        The state that follows.

    Raises
    ------
    DeviceError
        If the rig is lost meanwhile; the run stays open.
    """
    finish(session, "" if session.rig is not None else session.snapshot.problem)
    return session.resting_state


def finish(session: Session, failure: str) -> None:
    """End the run that is on.

    Parameters
    ----------
    session : Session
        With a run; the rig may be gone.
    failure : str
        Why the run ends before its time, empty if it does not.
    """
    run, rig = session.run, session.rig
    assert run is not None
    session.end_requested = False
    if rig is None:
        session.end_gap(run, None)  # what the camera has done since will never be known
    else:
        _stop_and_drain(session, rig, run)
        if rig.camera.run_label() == run.label:
            run.reconcile_with_camera(rig.camera, away=False)
        else:
            session.add_gap_of_power_loss(run)
    for block in run.finish():
        session.hand_out(block, time.monotonic(), run)
    _conclude(session, run, failure)


def fail_run(session: Session, reason: str) -> State:
    """Give up a run that can't go on, such as one whose frames have another geometry.

    Parameters
    ----------
    session : Session
        With or without a run.
    reason : str
        What is wrong, in words.

    Returns
    -------
    State
        The state that follows.
    """
    session.on_event("run failed", {"reason": reason})
    run = session.run
    if run is not None:
        if run.plan.live:
            session.live = None
        _conclude(session, run, reason)
    session.report_problem(reason)
    return session.resting_state


def give_up(session: Session, reason: str) -> None:
    """Leave everything after a fault of the program, so that acquisition can begin anew.

    The run ends, with its frames accounted for as far as that is still possible.

    Parameters
    ----------
    session : Session
        In any state, also in one that it should never be in.
    reason : str
        What happened, in words.
    """
    for attempt in (finish, _conclude_as_it_is):
        if session.run is not None:
            with suppress(BaseException):  # whatever failed before may fail again here
                attempt(session, reason)
    future, session.future = session.future, None
    if future is not None and not future.done():
        future.set_exception(CaptureError(reason))
    session.run = session.recorder = None
    rig, session.rig = session.rig, None
    if rig is not None:
        with suppress(BaseException):
            rig.close()
    session.open_gap = None
    session.failed = True
    session.publish(State.FAILED, problem=reason)


def _conclude_as_it_is(session: Session, reason: str) -> None:
    if session.run is not None:
        _conclude(session, session.run, reason)


def _stop_and_drain(session: Session, rig: Rig, run: Run) -> None:
    """Stop the camera and read what is under way, until its stream is silent."""
    if not run.ended:
        rig.camera.stop()
    quiet_since = time.monotonic()
    while time.monotonic() - quiet_since < SETTLE_S:
        piece = rig.camera.read(READ_S)
        if piece:
            quiet_since = time.monotonic()
            session.take(rig, run, piece, quiet_since)
        elif run.ended:
            break


def _conclude(session: Session, run: Run, failure: str) -> None:
    """Add the run to the totals, finish its recording, and tell whoever asked for it."""
    recorder, session.recorder = session.recorder, None
    if recorder is not None:
        recorder.close()
        run.accounting.disk = max(0, run.delivered_in_all - recorder.frames)
        failure = failure or recorder.failure
    session.totals_before += run.update_totals()
    session.photons_before += run.photons
    result = run.result(failure, simulated=session.snapshot.simulated)
    if recorder is not None:
        result = replace(result, recorded_frames=recorder.frames, recorded_bytes=recorder.size)
    if run.precision is not None:
        run.precision.close()
    session.run = None
    future, session.future = session.future, None
    lost = result.totals.losses.as_dict()
    session.on_event(
        "run ended",
        {"kind": run.plan.kind, "frames": result.totals.delivered, "failure": failure}
        | {f"lost_{place}": frames for place, frames in lost.items() if frames},
    )
    if future is not None:
        future.set_result(result)
