# SPDX-License-Identifier: Apache-2.0
"""The frame guard, between a sensor that cannot wait and a formatter that may be busy.

Every requested readout ends in exactly one of three ways. It is *passed* to the formatter
completely; it is *dropped* completely before its first beat; or, if a problem appears later, it is
*aborted*: the packet that was begun ends early and states so.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..frame_format import FrameFormat
from ..sensor.port import sensor_beat_layout

PATIENCE_CLOCKS = 1 << 20
"""Clocks without a beat after which a readout is given up: 10 ms at 100 MHz."""


class FrameGuard(wiring.Component):
    """Admits, passes or gives up readouts.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    patience : int
        Number of clocks without a beat after which a readout counts as a fault.

    Members
    -------
    read : In(1)
        A readout is asked for.
    give_up : In(1)
        End the readout in the next clock.
    sensor : In(stream)
        See `sensor_beat_layout`; never waits.
    admit : In(1)
        A frame that begins now would find room.
    beats : Out(stream)
        To the formatter.
    ends : In(1)
        From the formatter: the next beat is its frame's last.
    abort : Out(1)
        To the formatter: give up the frame in progress.
    busy : Out(1)
        A readout is asked for and not over.
    passed, dropped, aborted : Out(1)
        What became of it, once for each readout.
    over : Out(1)
        The readout is over.
    fault : Out(1)
        The sensor sent fewer or more codes than a frame has, or none.
    """

    def __init__(self, form: FrameFormat, *, patience: int = PATIENCE_CLOCKS) -> None:
        self.form = form
        self.patience = patience
        super().__init__(
            {
                "read": In(1),
                "give_up": In(1),
                "sensor": In(stream.Signature(sensor_beat_layout(form), always_ready=True)),
                "admit": In(1),
                "beats": Out(stream.Signature(form.codes_layout(form.lanes))),
                "ends": In(1),
                "abort": Out(1),
                "busy": Out(1),
                "passed": Out(1),
                "dropped": Out(1),
                "aborted": Out(1),
                "over": Out(1),
                "fault": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        beat, comes = self.sensor.payload, self.sensor.valid
        waited = Signal(range(self.patience + 1))
        waits, late, ends_now = Signal(), Signal(), Signal()
        m.d.comb += [
            waits.eq(self.busy & ~comes),
            self.beats.payload.eq(beat.codes),
        ]
        m.d.sync += [
            waited.eq(Mux(waits, waited + 1, 0)),
            late.eq(waits & (waited == self.patience - 1)),
            ends_now.eq(self.give_up | (waits & (waited == self.patience - 1))),
        ]

        in_frame = Signal()
        taken = Signal()
        right = self._marks(m, taken, in_frame)
        m.d.comb += taken.eq(self.beats.valid & self.beats.ready)
        last_seen = Signal()  # of a frame that is not passed
        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += last_seen.eq(0)
                with m.If(self.read):
                    m.next = "FIRST"
            with m.State("FIRST"):
                m.d.comb += [
                    self.busy.eq(1),
                    self.beats.valid.eq(comes & right & self.admit & ~ends_now),
                ]
                with m.If(ends_now):
                    m.d.comb += [self.dropped.eq(1), self.over.eq(1), self.fault.eq(late)]
                    m.next = "IDLE"
                with m.Elif(taken):
                    m.next = "PASS"
                    with m.If(self.ends):
                        m.d.comb += [self.passed.eq(1), self.over.eq(1)]
                        m.next = "IDLE"
                with m.Elif(comes):
                    m.d.comb += [self.dropped.eq(1), self.fault.eq(~right)]
                    m.d.sync += last_seen.eq(beat.last)
                    m.next = "SKIP"
            with m.State("PASS"):
                m.d.comb += [
                    self.busy.eq(1),
                    in_frame.eq(1),
                    self.beats.valid.eq(comes & right & ~ends_now),
                ]
                with m.If(ends_now):
                    m.d.comb += self.fault.eq(late)
                    m.d.sync += last_seen.eq(1)
                    m.next = "ABORT"
                with m.Elif(taken):
                    with m.If(self.ends):
                        m.d.comb += [self.passed.eq(1), self.over.eq(1)]
                        m.next = "IDLE"
                with m.Elif(comes):
                    m.d.comb += self.fault.eq(~right)
                    m.d.sync += last_seen.eq(beat.last)
                    m.next = "ABORT"
            with m.State("ABORT"):
                m.d.comb += [self.busy.eq(1), self.abort.eq(1), self.aborted.eq(1)]
                with m.If(comes & beat.last):
                    m.d.sync += last_seen.eq(1)
                m.next = "SKIP"
            with m.State("SKIP"):
                m.d.comb += self.busy.eq(1)
                with m.If(last_seen | (comes & beat.last) | ends_now):
                    m.d.comb += [self.over.eq(1), self.fault.eq(late & ~last_seen)]
                    m.next = "IDLE"
        return m

    def _marks(self, m: Module, taken: Signal, in_frame: Signal) -> Signal:
        """Return whether a beat's marks are those that its place in the frame has."""
        form = self.form
        beat = self.sensor.payload
        col, after = (Signal(range(form.cols)) for _ in range(2))  # of lane 0, and of its next
        # what is compared with a beat's marks is known before the beat comes
        begins = Signal(2, init=0b11)  # a row, in the beat, or in it as a frame's last
        right = Signal()
        step = form.lanes % form.cols
        row_begins = Signal()
        m.d.comb += [
            after.eq(Mux(col >= form.cols - step, col + step - form.cols, col + step)),
            row_begins.eq(Mux(self.ends, begins[1], begins[0])),
            right.eq(
                (beat.first == ~in_frame) & (beat.last == self.ends) & (beat.row == row_begins)
            ),
        ]
        with m.If(~self.busy):  # as it is between any two readouts
            m.d.sync += [col.eq(0), begins.eq(begins.init)]
        with m.Elif(taken):
            m.d.sync += col.eq(after)
            for number, used in enumerate((form.lanes, form.last_lanes)):
                m.d.sync += begins[number].eq((after == 0) | (after > form.cols - used))
        return right
