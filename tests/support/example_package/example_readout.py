# SPDX-License-Identifier: Apache-2.0
"""A readout of somebody else's sensor: every pixel has the number of its frame as its code."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from hueflight_hdl.camera.frame_format import FrameFormat
from hueflight_hdl.camera.sensor.port import SensorPort


class ExampleReadout(wiring.Component):
    """Sends a beat in every second clock, one pixel in each."""

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        super().__init__({"port": In(SensorPort(form))})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form, beats = self.form, self.port.beats
        frame, pause = Signal(form.code_bits), Signal()
        row, col = Signal(range(form.rows)), Signal(range(form.cols))
        running = Signal()
        m.d.comb += [
            beats.valid.eq(running & ~pause),
            beats.payload.codes[0].eq(frame),
            beats.payload.first.eq((row == 0) & (col == 0)),
            beats.payload.row.eq(col == 0),
            beats.payload.last.eq((row == form.rows - 1) & (col == form.cols - 1)),
        ]
        with m.If(self.port.read):
            m.d.sync += [running.eq(1), pause.eq(0), row.eq(0), col.eq(0), frame.eq(frame + 1)]
        with m.Elif(running):
            m.d.sync += pause.eq(~pause)
            with m.If(~pause):
                m.d.sync += [running.eq(~beats.payload.last), col.eq(col + 1)]
                with m.If(col == form.cols - 1):
                    m.d.sync += [col.eq(0), row.eq(row + 1)]
        return m
