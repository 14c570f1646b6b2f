# SPDX-License-Identifier: Apache-2.0
"""The trigger's filter finds exactly the edges that its register states."""

from __future__ import annotations

from amaranth.hdl import Assert, Assume, Cat, Module, Mux, Signal

from hueflight_protocol.illuminator_map import MAX_FILTER_TICKS

from ..illuminator.pulse_generator.config import PulseConfig
from ..illuminator.pulse_generator.trigger_filter import TriggerFilter, filter_latency
from .harness import FreeHarness


class FilterHarness(FreeHarness):
    """A filter whose input does anything, with settings at rest.

    Parameters
    ----------
    lanes : int
        Ticks per clock.
    """

    spare = 0
    """Ticks by which the stated width differs from the filter's; not 0 in false variants."""

    def __init__(self, lanes: int) -> None:
        self.config = PulseConfig(channels=1, lanes=lanes)
        self.filter = TriggerFilter(self.config)
        super().__init__(self.filter)

    def state(self, m: Module) -> None:
        """Compare each clock with the definition, on a record of the input's ticks."""
        lanes = self.config.lanes
        begun, falling = Signal(), Signal()
        width = Signal.like(self.width)
        m.d.sync += [begun.eq(1), falling.eq(self.falling), width.eq(self.width)]
        with m.If(begun):
            m.d.comb += [Assume(self.falling == falling), Assume(self.width == width)]

        # the newest tick last; the clock of interest came `latency` clocks ago
        reach = MAX_FILTER_TICKS
        after = lanes * filter_latency(lanes)
        ticks = Signal(reach + after, init=-1)
        m.d.sync += ticks.eq(Cat(ticks, self.samples)[lanes:])
        m.d.comb += Assume(self.before == ticks[-1])
        levels = ticks ^ self.falling.replicate(len(ticks))
        found = Signal(lanes)
        for lane in range(lanes):
            here = reach + lane
            far = [
                (self.width + self.spare <= k) | (levels[here + k] & ~levels[here - 1 - k])
                for k in range(1, reach)
            ]
            m.d.comb += found[lane].eq(levels[here] & ~levels[here - 1] & Cat(far).all())
        lane = 0
        for number in reversed(range(lanes)):
            lane = Mux(found[number], number, lane)
        settled = Signal(range(filter_latency(lanes) + 2))
        with m.If(settled != filter_latency(lanes) + 1):
            m.d.sync += settled.eq(settled + 1)
        with m.Else():
            m.d.comb += Assert(self.filter.edge == found.any())
            with m.If(self.filter.edge):
                m.d.comb += Assert(self.filter.lane == lane)
