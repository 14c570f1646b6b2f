# SPDX-License-Identifier: Apache-2.0
"""Properties of exposures and readouts, for all registers, requests and sensors."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ..camera.exposure.control import EXPOSURE_LAYOUT, ExposureControl
from ..camera.exposure.frame_guard import FrameGuard
from ..camera.frame_format import FrameFormat
from ..camera.sensor.port import sensor_beat_layout

FORM = FrameFormat(rows=2, cols=8, lanes=8, run=8, code_bits=1)
PATIENCE = 3


class CaptureHarness(wiring.Component):
    """Exposure control and frame guard as a camera has them, with everything else free."""

    def __init__(self) -> None:
        super().__init__(
            {
                "settings": In(EXPOSURE_LAYOUT),
                "start": In(1),
                "stop": In(1),
                "abort": In(1),
                "ready": In(1),
                "beat": In(sensor_beat_layout(FORM)),
                "comes": In(1),
                "admit": In(1),
                "takes": In(1),
                "ends": In(1),
            }
        )
        self.exposure = ExposureControl()
        self.guard = FrameGuard(FORM, patience=PATIENCE)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.exposure = exposure = self.exposure
        m.submodules.guard = guard = self.guard
        m.d.comb += [
            exposure.settings.eq(self.settings),
            exposure.start.eq(self.start),
            exposure.stop.eq(self.stop),
            exposure.abort.eq(self.abort),
            exposure.ready.eq(self.ready),
            exposure.read_done.eq(guard.over),
            guard.read.eq(exposure.read),
            guard.give_up.eq(exposure.give_up),
            guard.sensor.valid.eq(self.comes),
            guard.sensor.payload.eq(self.beat),
            guard.admit.eq(self.admit),
            guard.beats.ready.eq(self.takes & ~guard.abort),
            guard.ends.eq(self.ends),
        ]
        self.state(m)
        return m

    def state(self, m: Module) -> None:
        """Add assertions."""


class AbortHarness(CaptureHarness):
    """An abort ends a capture, and a start begins one, in a few clocks."""

    CLOCKS = 8

    def state(self, m: Module) -> None:
        """Count clocks since an abort, and since a start that may begin."""
        exposure, guard = self.exposure, self.guard
        aborted, started = Signal(), Signal()
        since_abort, since_start = (Signal(range(self.CLOCKS + 1)) for _ in range(2))
        for on, since, begins, ends in (
            (aborted, since_abort, self.abort & ~self.start, self.start),
            (started, since_start, self.start, exposure.began | self.stop | self.abort),
        ):
            with m.If(since != self.CLOCKS):
                m.d.sync += since.eq(since + 1)
            with m.If(ends):
                m.d.sync += on.eq(0)
            with m.Elif(begins & ~on):
                m.d.sync += [on.eq(1), since.eq(0)]
        with m.If(~self.ready):
            m.d.sync += since_start.eq(0)
        with m.If(aborted):
            m.d.comb += Assert(~exposure.starting)
        with m.If(aborted & (since_abort == self.CLOCKS)):
            m.d.comb += [
                Assert(~exposure.running),
                Assert(~exposure.exposing),
                Assert(~exposure.expose),
                Assert(~guard.busy),
            ]
        with m.If(started):
            m.d.comb += [Assert(exposure.starting), Assert(since_start != self.CLOCKS)]


class VerdictHarness(CaptureHarness):
    """Every readout ends once, as passed, dropped or aborted, and no verdict comes without one."""

    def state(self, m: Module) -> None:
        """Count the verdicts of a readout."""
        guard = self.guard
        judged = Signal()
        verdicts = guard.passed + guard.dropped + guard.aborted
        m.d.comb += Assert(verdicts + judged <= 1)
        with m.If(guard.over):
            m.d.comb += [Assert(guard.busy), Assert(verdicts + judged == 1)]
            m.d.sync += judged.eq(0)
        with m.Elif(verdicts != 0):
            m.d.comb += Assert(guard.busy)
            m.d.sync += judged.eq(1)
