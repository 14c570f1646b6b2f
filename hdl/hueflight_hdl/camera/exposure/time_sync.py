# SPDX-License-Identifier: Apache-2.0
"""A common time of several boards: an edge at a pin sets the device clock to 0."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

PULSE_CLOCKS = 16
"""Clocks for which the output is high."""


class TimeSync(wiring.Component):
    """Waits for an edge that is common to several boards, and can send one.

    Boards that run from one clock and get one edge count the same time from then on. If the edge
    comes while their clocks sample it, they differ by a clock; one that another of these boards
    sends has the same phase each time.

    Members
    -------
    arm, send : In(1)
        Wait for a rising edge; send one.
    failed : In(1)
        The clock has failed: what was counted since the edge is no longer common.
    pin : In(1)
        The input, not synchronous.
    output : Out(1)
        The output, high for `PULSE_CLOCKS`.
    zero : Out(1)
        The device clock is to be 0 after this clock.
    armed : Out(1)
        An edge is waited for.
    done : Out(1)
        It has come, and the clock has not failed since.
    level : Out(1)
        Of the input.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "arm": In(1),
                "send": In(1),
                "failed": In(1),
                "pin": In(1),
                "output": Out(1),
                "zero": Out(1),
                "armed": Out(1),
                "done": Out(1),
                "level": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        before = Signal()
        m.submodules.level = FFSynchronizer(self.pin, self.level)
        m.d.sync += [before.eq(self.level), self.zero.eq(0)]
        with m.If(self.failed):
            m.d.sync += [self.armed.eq(0), self.done.eq(0)]
        with m.Elif(self.arm):
            m.d.sync += [self.armed.eq(1), self.done.eq(0)]
        with m.Elif(self.armed & self.level & ~before):
            m.d.sync += [self.zero.eq(1), self.armed.eq(0), self.done.eq(1)]

        left = Signal(range(PULSE_CLOCKS + 1))
        with m.If(self.send):
            m.d.sync += left.eq(PULSE_CLOCKS)
        with m.Elif(left != 0):
            m.d.sync += left.eq(left - 1)
        m.d.sync += self.output.eq(left != 0)
        return m
