# SPDX-License-Identifier: Apache-2.0
"""The limits of on-time and duty hold for every demand of the generator."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Mux, Signal

from ..illuminator.pulse_generator.config import Limits
from ..illuminator.pulse_generator.limiter import OutputLimiter
from .harness import FreeHarness


class LimiterHarness(FreeHarness):
    """The output limiter with a free demand in every tick, more than registers can cause.

    Parameters
    ----------
    limits : Limits
    lanes : int
    """

    def __init__(self, limits: Limits, *, lanes: int) -> None:
        self.limits = limits
        self.limiter = OutputLimiter(limits, lanes=lanes)
        super().__init__(self.limiter)


class OnTimeHarness(LimiterHarness):
    """No run of ticks is longer than allowed."""

    def state(self, m: Module) -> None:
        """Count the ticks of the run that ends in each tick."""
        longest = self.limits.max_on_ticks
        run = length = Signal(range(longest + self.limiter.lanes + 1))
        for lane in range(self.limiter.lanes):
            longer = Signal.like(run, name=f"run{lane}")
            m.d.comb += [
                longer.eq(Mux(self.limiter.level[lane], length + 1, 0)),
                Assert(longer <= longest),
            ]
            length = longer
        m.d.sync += run.eq(length)


class DutyHarness(LimiterHarness):
    """In any stretch of L ticks an LED is on for at most L / divisor + burst.

    The level of a leaky bucket that takes ``divisor`` for each tick that is on, and loses one in
    every tick, is the most that any stretch that ends here has of ``divisor * on - L``.
    """

    def state(self, m: Module) -> None:
        """Fill the bucket tick by tick."""
        limiter = self.limiter
        limits, lanes = self.limits, limiter.lanes
        divisor, most = limits.duty_divisor, limits.duty_divisor * limits.burst_ticks
        bucket = Signal(range(-1, 2 * most + divisor * lanes))
        level = bucket
        for lane in range(lanes):
            fuller = Signal.like(bucket, name=f"bucket{lane}")
            filled = level + Mux(limiter.level[lane], divisor - 1, -1)
            m.d.comb += [fuller.eq(Mux(filled < 0, 0, filled)), Assert(fuller <= most)]
            level = fuller
        m.d.sync += bucket.eq(level)
        # what the induction needs: the limiter's own level, of the clocks before this one, is
        # not lower than the bucket, but for what a run that ends within a clock has beyond it
        own = limiter.duty_level
        for clock in range(3):
            before = Signal.like(limiter.duty_level, name=f"own{clock}")
            m.d.sync += before.eq(own)
            own = before
        floored = Mux(own < 0, 0, Mux(own > limiter.ceiling, limiter.ceiling, own))
        m.d.comb += [Assert(bucket >= 0), Assert(bucket <= floored + lanes - 1)]
