# SPDX-License-Identifier: Apache-2.0
"""A saturating counter for fast clocks, with a pipelined carry."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring

from .counter import counter_members


class FastCounter(wiring.Component):
    """Counts events and stays at the largest value; the carry passes half the bits in each clock.

    Parameters
    ----------
    width : int
        Bits of the value, an even number.

    Members
    -------
    event : In(1)
        Count one event in this clock.
    clear : In(1)
        Return to 0; has precedence over `event`.
    value : Out(width)
        Number of events, four clocks late; it always shows a count that was correct in some
        clock.
    saturated : Out(1)
        There were more events than `value` can show.
    """

    def __init__(self, width: int = 32) -> None:
        self.width = width
        super().__init__(counter_members(width))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        half = self.width // 2
        event = Signal()
        low = Signal(half + 1)  # the carry on top
        low_before = Signal(half)  # as old as `high`
        high = Signal(half + 1)
        m.d.pulse += [
            event.eq(self.event),
            low.eq(low[:half] + event),
            low_before.eq(low[:half]),
            high.eq(high[:half] + low[half]),
            self.saturated.eq(self.saturated | high[half]),
            self.value.eq(Mux(self.saturated | high[half], -1, Cat(low_before, high[:half]))),
        ]
        with m.If(self.clear):
            m.d.pulse += [
                event.eq(0),
                low.eq(0),
                low_before.eq(0),
                high.eq(0),
                self.saturated.eq(0),
                self.value.eq(0),
            ]
        return m
