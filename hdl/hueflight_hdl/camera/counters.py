# SPDX-License-Identifier: Apache-2.0
"""Counters of a capture; none of them wraps."""

from __future__ import annotations

from amaranth.hdl import Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..common.counter import SaturatingCounter
from .messages import COUNTERS_LAYOUT

EVENT_COUNTERS = ("frames_dropped", "frames_aborted", "triggers_lost", "stall_clocks", "faults")


class CaptureCounters(wiring.Component):
    """Counts the frames, hits, triggers and faults of a capture.

    Members
    -------
    began : In(1)
        A capture begins: all but `frame` go to 0.
    frames_dropped, frames_aborted, triggers_lost, stall_clocks, faults : In(1)
        High in each clock to be counted.
    sent : In(1), hits : In(32)
        A frame was sent whole, with so many hits.
    triggered : In(1)
        A trigger was sent.
    waiting : In(32)
        Bytes that wait for the link.
    frame : In(64)
        Number of the present frame.
    counters : Out
        See `COUNTERS_LAYOUT`.
    hits_sent, periods : Out(64)
        Hits in frames sent; triggers.
    saturated : Out(1)
        A counter stands at its largest value.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "began": In(1),
                **{name: In(1) for name in EVENT_COUNTERS},
                "sent": In(1),
                "hits": In(32),
                "triggered": In(1),
                "waiting": In(32),
                "frame": In(64),
                "counters": Out(COUNTERS_LAYOUT),
                "hits_sent": Out(64),
                "periods": Out(64),
                "saturated": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        saturated = Const(0)
        for name in EVENT_COUNTERS:
            counter = SaturatingCounter()
            m.submodules[name] = counter
            m.d.comb += [
                counter.event.eq(getattr(self, name)),
                counter.clear.eq(self.began),
                self.counters[name].eq(counter.value),
            ]
            saturated = saturated | counter.saturated
        m.d.comb += self.saturated.eq(saturated)

        # 64 bits count for millennia; what is sent is registered before their carries
        frames_sent, sent = Signal(64), Signal()
        peak, waiting = Signal(32), Signal(32)
        added = Signal(32)
        m.d.sync += [
            sent.eq(self.sent),
            frames_sent.eq(frames_sent + sent),
            added.eq(Mux(self.sent, self.hits, 0)),
            self.hits_sent.eq(self.hits_sent + added),
            self.periods.eq(self.periods + self.triggered),
            waiting.eq(self.waiting),
        ]
        with m.If(waiting > peak):
            m.d.sync += peak.eq(waiting)
        with m.If(self.began):
            m.d.sync += [frames_sent.eq(0), self.hits_sent.eq(0), self.periods.eq(0), peak.eq(0)]
        m.d.comb += [
            self.counters.frame.eq(self.frame),
            self.counters.frames_sent.eq(frames_sent),
            self.counters.buffer_peak.eq(peak),
        ]
        return m
