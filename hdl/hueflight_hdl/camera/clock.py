# SPDX-License-Identifier: Apache-2.0
"""What a camera that can run from an external clock has besides: the choice, and a common time."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from ..control.clock_choice import clock_members, connect_clock_choice, count_clock_failures
from ..control.register_file import RegisterFile
from .exposure.control import ExposureControl
from .exposure.time_sync import TimeSync


def camera_clock_members() -> dict[str, wiring.Member]:
    """Return the signature members of such a camera; see `camera.camera.Camera`."""
    return {**clock_members(), "clock_failed": In(1), "time_sync": In(1), "time_sync_out": Out(1)}


def connect_clock(
    m: Module, camera: wiring.PureInterface, registers: RegisterFile, exposure: ExposureControl, /
) -> Signal:
    """Connect the choice of the clock, its failures and the common time.

    Parameters
    ----------
    m : Module
        The camera's module.
    camera : PureInterface
        Has the members of `camera_clock_members`.
    registers : RegisterFile
        Registers of the camera.
    exposure : ExposureControl
        Has the device clock.

    Returns
    -------
    Signal
        The clock fails: no capture can be on.
    """
    failed = Signal(init=1)
    m.submodules.clock_failed = FFSynchronizer(camera.clock_failed, failed, init=1)
    count_clock_failures(m, registers, failed)
    wanted = connect_clock_choice(m, registers, camera.reference_state)
    m.submodules.time_sync = time = TimeSync()
    m.d.comb += [
        camera.reference_wanted.eq(wanted),
        time.arm.eq(registers.time_sync.arm),
        time.send.eq(registers.time_sync.send),
        time.failed.eq(failed),
        time.pin.eq(camera.time_sync),
        camera.time_sync_out.eq(time.output),
        exposure.zero.eq(time.zero),
        registers.time_state.armed.eq(time.armed),
        registers.time_state.done.eq(time.done),
        registers.time_state.level.eq(time.level),
    ]
    return failed
