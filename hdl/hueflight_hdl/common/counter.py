# SPDX-License-Identifier: Apache-2.0
"""A counter that saturates instead of wrapping."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


def counter_members(width: int, /) -> dict[str, wiring.Member]:
    """Return the signature members that all counters share."""
    return {"event": In(1), "clear": In(1), "value": Out(width), "saturated": Out(1)}


class SaturatingCounter(wiring.Component):
    """Counts events and stays at the largest value.

    Parameters
    ----------
    width : int
        Bits of the value.
    domain : str
        Clock domain.

    Members
    -------
    event : In(1)
        Count one event in this clock.
    clear : In(1)
        Return to 0; has precedence over `event`.
    value : Out(width)
        Number of events.
    saturated : Out(1)
        There were more events than `value` can show.
    """

    def __init__(self, width: int = 32, *, domain: str = "sync") -> None:
        self.width = width
        self.domain = domain
        super().__init__(counter_members(width))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        domain = m.d[self.domain]
        count = Signal(self.width + 1)
        carried = Signal()
        m.d.comb += [
            self.saturated.eq(carried | count[-1]),
            self.value.eq(Mux(self.saturated, -1, count[:-1])),
        ]
        domain += [count.eq(count[:-1] + self.event), carried.eq(self.saturated)]
        with m.If(self.clear):
            domain += [count.eq(0), carried.eq(0)]
        return m
