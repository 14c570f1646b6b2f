# SPDX-License-Identifier: Apache-2.0
"""One time for several cameras: an edge that all of them get sets their time stamps to 0."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError
from hueflight_protocol.typed_registers import camera as registers

_PAUSE_S = 0.005


def has_common_time(camera: Camera, /) -> bool:
    """Read whether a camera's time began with an edge, and its clock has not failed since.

    Parameters
    ----------
    camera : Camera
        The camera.

    Returns
    -------
    bool
        True if so.
    """
    if registers.TimeState.ADDRESS not in camera.board.registers:
        return False
    return bool(camera.board.read(registers.TimeState).done)


def start_common_time(
    cameras: Sequence[Camera],
    /,
    *,
    give_edge: Callable[[], object] | None = None,
    timeout_s: float = 1.0,
) -> None:
    """Set the time stamps of several cameras to 0 at one moment.

    They must run from one clock, or their times drift apart again. With the output
    ``time_sync_out`` of the first one at the input ``time_sync`` of all, itself included, times
    agree to the clock; with an edge from elsewhere, which may come while the clocks sample it, they
    may differ by one clock.

    Parameters
    ----------
    cameras : sequence of Camera
        The cameras, in no run.
    give_edge : callable, optional
        Gives the edge from elsewhere, for example by a generator; by default the first camera sends
        it.
    timeout_s : float
        Longest time to wait for the edge, in seconds.

    Raises
    ------
    DeviceError
        If a camera has no such input, is in a run, or does not get the edge.
    """
    for camera in cameras:
        place = camera.identity.place
        if registers.TimeState.ADDRESS not in camera.board.registers:
            raise DeviceError(
                f"the camera at {place} was built without an external clock and a common time: "
                "build it with --set reference_hz=FREQUENCY"
            )
        if camera.running():
            raise DeviceError(
                f"the camera at {place} is in a run, whose time stamps would jump: stop it first"
            )
    for camera in cameras:
        camera.board.write(registers.TimeSync(arm=1))
    if give_edge is not None:
        give_edge()
    elif cameras:
        cameras[0].board.write(registers.TimeSync(send=1))
    deadline = time.monotonic() + timeout_s
    while waiting := [camera for camera in cameras if not has_common_time(camera)]:
        if time.monotonic() > deadline:
            places = ", ".join(camera.identity.place for camera in waiting)
            raise DeviceError(
                f"no edge came to the input time_sync of {places} within {timeout_s} s: check the "
                "wiring"
            )
        time.sleep(_PAUSE_S)
