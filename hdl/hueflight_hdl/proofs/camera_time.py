# SPDX-License-Identifier: Apache-2.0
"""Cameras that get one edge have one time, until a clock fails or another edge is waited for."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ..camera.exposure.control import ExposureControl
from ..camera.exposure.time_sync import TimeSync

CAMERAS = 2


class TimeHarness(wiring.Component):
    """Two cameras on one clock, configured at any times, with one edge and any requests."""

    def __init__(self) -> None:
        self.syncs = [TimeSync() for _ in range(CAMERAS)]
        self.exposures = [ExposureControl(time_sync=True) for _ in range(CAMERAS)]
        super().__init__(
            {name: In(CAMERAS) for name in ("arm", "send", "failed", "start")} | {"pin": In(1)}
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        armed, settled = Signal(CAMERAS), Signal(range(4))
        with m.If(settled != 3):
            m.d.sync += settled.eq(settled + 1)
        for number, (sync, exposure) in enumerate(zip(self.syncs, self.exposures, strict=True)):
            m.submodules[f"sync{number}"] = sync
            m.submodules[f"exposure{number}"] = exposure
            level, before = Signal(name=f"level{number}"), Signal(name=f"before{number}")
            failed = Signal(name=f"failed{number}")
            m.d.comb += [
                sync.arm.eq(self.arm[number]),
                sync.send.eq(self.send[number]),
                sync.failed.eq(self.failed[number]),
                sync.pin.eq(self.pin),
                exposure.zero.eq(sync.zero),
                exposure.start.eq(self.start[number]),
                exposure.ready.eq(1),
            ]
            m.d.sync += [
                armed[number].eq(sync.armed),
                level.eq(sync.level),
                before.eq(level),
                failed.eq(sync.failed),
            ]
            with m.If(sync.zero):  # only a rising edge, for a camera that waited for one
                m.d.comb += Assert(armed[number] & level & ~before & sync.done)
            with m.If(failed & (settled != 0)):
                m.d.comb += Assert(~sync.armed & ~sync.done)

        # since all got the same edge, none has failed or waited for another
        shared = Signal()
        both = self.syncs[0].zero & self.syncs[1].zero
        with m.If((self.arm | self.failed).any()):
            m.d.sync += shared.eq(0)
        with m.Elif(both):
            m.d.sync += shared.eq(1)
        with m.If(shared):
            m.d.comb += [
                Assert(self.syncs[0].done & self.syncs[1].done),
                Assert(~self.syncs[0].armed & ~self.syncs[1].armed),
                Assert(self.exposures[0].now == self.exposures[1].now),
            ]
        return m
