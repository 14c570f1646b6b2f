"""A counter that stays at its largest value rather than begin again."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


def counter_members(width: int, /) -> dict[str, wiring.Member]:
    """Return what every counter here has."""
    return {"event": In(1), "clear": In(1), "value": Out(width), "saturated": Out(1)}


class SaturatingCounter(wiring.Component):
    """Counts events; a carry out of the top is kept, and holds the value at all ones.

    Members
    -------
    event : In(1)
    clear : In(1)
        Has precedence.
    value : Out(width)
    saturated : Out(1)
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
