# SPDX-License-Identifier: Apache-2.0
"""The state in which a run is on: read its stream, and watch over the camera."""

from __future__ import annotations

import time

from hueflight.acquisition.run import Run
from hueflight.acquisition.session import POWER_LOST, Session
from hueflight.acquisition.states import State
from hueflight.devices.errors import DeviceGoneError
from hueflight.devices.rig import Rig

READ_S = 0.05
SILENCE_S = 2.0  #: without a byte in a run, ask the camera whether it is still there
KEEP_ALIVE_S = 0.3


def read_stream(session: Session) -> State:
    """Take one piece of the stream: the work of `State.RUNNING`.

    Parameters
    ----------
    session : Session
        With a rig and a run.

    Returns
    -------
    State
        The state that follows.

    Raises
    ------
    DeviceError
        If the rig is gone.
    """
    rig, run = session.rig, session.run
    assert rig is not None
    assert run is not None
    piece = rig.camera.read(READ_S)
    now = time.monotonic()
    if now - session.kept_alive_s > KEEP_ALIVE_S:
        session.kept_alive_s = now
        rig.illumination.keep_alive()
    if piece:
        session.take(rig, run, piece, now)
    elif now - max(run.last_data_s, run.began_s) > run.silence_s(SILENCE_S):
        _check_silent_camera(rig, run, now)
    return State.ENDING if run.ended or session.is_over(run, now) else State.RUNNING


def _check_silent_camera(rig: Rig, run: Run, now: float) -> None:
    """Find out why nothing comes: the camera may be gone, or its run may be over."""
    run.last_data_s = now
    if rig.camera.running():
        return
    if rig.camera.run_label() != run.label:
        raise DeviceGoneError(f"{rig.camera.identity.place}: {POWER_LOST}")
    run.ended = True  # it ended by itself, and the event that says so was lost
