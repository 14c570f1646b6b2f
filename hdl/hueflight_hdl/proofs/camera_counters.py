# SPDX-License-Identifier: Apache-2.0
"""A capture's counters never decrease."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Signal

from ..camera.counters import EVENT_COUNTERS, CaptureCounters
from .harness import FreeHarness

LIMIT_64 = (1 << 64) - (1 << 32)


class CountersHarness(FreeHarness):
    """Counters with free inputs; 64-bit counters are not checked near their wrap-around."""

    def __init__(self) -> None:
        self.counters = CaptureCounters()
        super().__init__(self.counters)

    def state(self, m: Module) -> None:
        """Compare with the clock before."""
        counters = self.counters
        told = counters.counters
        narrow = [told[name] for name in (*EVENT_COUNTERS, "buffer_peak")]
        wide = [told.frames_sent, counters.hits_sent, counters.periods]
        began, seen = Signal(), Signal()
        m.d.sync += [began.eq(self.began), seen.eq(1)]
        for value in (*narrow, *wide):
            before = Signal.like(value)
            m.d.sync += before.eq(value)
            grows = value >= before
            if any(value is one for one in wide):
                grows |= before >= LIMIT_64
            with m.If(seen & ~began):
                m.d.comb += Assert(grows)
            with m.If(seen & began):
                m.d.comb += Assert(value <= 1)
