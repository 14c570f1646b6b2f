# SPDX-License-Identifier: Apache-2.0
"""The states without a rig: look for it, and go on with the run that its loss interrupted."""

from __future__ import annotations

import time

from hueflight.acquisition.session import Session
from hueflight.acquisition.starting import start_camera
from hueflight.acquisition.states import State
from hueflight.devices.errors import DeviceError
from hueflight.devices.rig import Rig

RECONNECT_S = 0.5


def search(session: Session) -> State:
    """Try to open the rig: the work of `State.SEARCHING`.

    Parameters
    ----------
    session : Session
        Without rig and run.

    Returns
    -------
    State
        The state that follows.
    """
    if not _connect(session):
        time.sleep(RECONNECT_S)
    return session.resting_state


def reconnect(session: Session) -> State:
    """Try to open the rig and go on with the run: the work of `State.INTERRUPTED`.

    Parameters
    ----------
    session : Session
        With a run, without a rig.

    Returns
    -------
    State
        The state that follows; the run ends if it has to before the rig is back.
    """
    run = session.run
    if run is not None and session.is_over(run, time.monotonic()):
        return State.ENDING
    if not _connect(session):
        time.sleep(RECONNECT_S)
    elif session.run is not None:
        _resume(session)
    return session.resting_state


def lose_rig(session: Session, error: DeviceError) -> State:
    """Close a rig that does not answer; a run that is on stays open.

    Parameters
    ----------
    session : Session
        With a rig that raised an error.
    error : DeviceError
        What it raised.

    Returns
    -------
    State
        The state that follows.
    """
    rig, session.rig = session.rig, None
    if rig is not None:
        rig.close()
    session.begin_gap(str(error))
    session.report_problem(str(error))
    session.on_event("disconnected", {"reason": str(error)})
    return session.resting_state


def _connect(session: Session) -> bool:
    """Open the rig and configure its camera; True if that worked."""
    try:
        rig = session.connect()
    except DeviceError as error:
        session.report_problem(str(error))
        return False
    try:
        _close_gap(session, rig)
        if rig.camera.running():
            rig.camera.stop(abort=True)
        # a run that goes on does so as it began: its recording may hold tables of sums
        run = session.run
        session.configure(rig, session.controls_for(session.live) if run is None else run.controls)
    except DeviceError as error:
        rig.close()
        session.report_problem(str(error))
        return False
    session.rig = rig
    session.connections += 1
    session.publish(session.resting_state, problem="")  # the first run may take long to prepare
    identity = rig.camera.identity
    session.on_event(
        "connected",
        {
            "serial": identity.serial,
            "place": identity.place,
            "frame_rate_hz": round(session.rate_hz or 0.0, 1),
        },
    )
    return True


def _close_gap(session: Session, rig: Rig) -> None:
    """Ask a camera that is back what it did meanwhile, and close the gap."""
    if session.open_gap is None:
        return
    run = session.run
    lost: int | None = None
    if run is not None and rig.camera.run_label() == run.label:
        # a link that goes away amid a start may leave the run's label beside the counters of
        # the run before, which are counted already
        begun = run.started or rig.camera.running()
        lost = run.reconcile_with_camera(rig.camera, away=True) if begun else 0
    session.end_gap(run, lost)


def _resume(session: Session) -> None:
    """Go on with the run as a new one of the camera's, whose totals are added to the first."""
    run, rig = session.run, session.rig
    assert run is not None
    assert rig is not None
    for block in run.finish():
        session.hand_out(block, time.monotonic(), run)
    run.accounting.disk = 0  # counted when the recording is closed
    session.totals_before += run.update_totals()
    session.photons_before += run.photons
    session.run = run.successor()
    session.label = session.run.label
    start_camera(rig.camera, session.run, rate_hz=session.settings.rate_hz)
