# SPDX-License-Identifier: Apache-2.0
"""The output limiter: keeps the on-time and duty of an LED below limits of the build."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .config import Limits


class OutputLimiter(wiring.Component):
    """Passes on the demand of a channel as long as it is within the limits.

    *On-time*: of a demand that stays on, the first ``max_on_ticks`` pass, exactly; the rest is
    cut until the demand goes off.

    *Duty*: a level rises by ``duty_divisor - 1`` with every tick that is demanded on and falls
    by one with every other tick, but not below 0; a clock passes only while the level, that
    clock's demand included, is at most `threshold`. Within any stretch of L ticks the channel is
    thus on for at most ``L / duty_divisor + burst_ticks``. The level stops at `ceiling`, so that
    a demand that stays too high is forgiven in bounded time.

    Both look at the demand, not at what passed: there is no loop through the output, the
    pipeline can be cut anywhere, and what passes is part of what was allowed.

    Members
    -------
    demand : In(lanes)
    allow : In(1)
        Nothing passes without it; one clock before the output.
    level : Out(lanes)
        Five clocks after the demand.
    on_limited, duty_limited : Out(1)
        In this clock something was cut.
    """

    latency = 5

    def __init__(self, limits: Limits, *, lanes: int) -> None:
        self.limits = limits
        self.lanes = lanes
        top = self.ceiling + limits.duty_divisor * lanes + 1
        self.duty_level = Signal(range(-lanes, top))  # three clocks after the demand
        super().__init__(
            {
                "demand": In(lanes),
                "allow": In(1),
                "level": Out(lanes),
                "on_limited": Out(1),
                "duty_limited": Out(1),
            }
        )

    @property
    def threshold(self) -> int:
        """Highest duty level at which a clock passes.

        The level is that of whole clocks; a stretch that begins and ends within clocks can have
        up to ``lanes - 1`` more at either end.
        """
        return self.limits.duty_divisor * self.limits.burst_ticks - 2 * (self.lanes - 1)

    @property
    def ceiling(self) -> int:
        """Highest duty level that is kept: a power of two, at least twice the limit."""
        return 1 << (2 * self.limits.duty_divisor * self.limits.burst_ticks - 1).bit_length()

    def elaborate(self, platform: object) -> Module:
        m = Module()
        demand = [Signal(self.lanes, name=f"demand{i}") for i in range(1, 5)]
        m.d.pulse += [
            later.eq(now) for now, later in zip([self.demand, *demand], demand, strict=False)
        ]
        keep3 = self._on_time(m, demand[0])
        over4 = self._duty(m, demand[0])
        keep4 = Signal(self.lanes)
        m.d.pulse += [
            keep4.eq(keep3),
            # 5: what passes
            *(
                self.level[i].eq(demand[3][i] & keep4[i] & self.allow & ~over4)
                for i in range(self.lanes)
            ),
            self.on_limited.eq((demand[3] & ~keep4).any()),
            self.duty_limited.eq(demand[3].any() & over4),
        ]
        return m

    def _on_time(self, m: Module, demand1: Signal) -> Signal:
        """Lanes that are within the longest on-time; two clocks after `demand1`."""
        lanes = range(self.lanes)
        longest = self.limits.max_on_ticks

        # 2: the shape of the word: runs that come in from the left and go out to the right
        lead2 = Signal(self.lanes)  # on, and so is every lane before
        tail2 = Signal(self.lanes)  # one-hot: the run at the right end begins in this lane
        m.d.pulse += [
            *(lead2[i].eq(demand1[: i + 1].all()) for i in lanes),
            *(tail2[i].eq(demand1[i:].all() & (~demand1[i - 1] if i else 1)) for i in lanes),
        ]

        # 3: ticks left to a run, as clocks and lanes, counted from the clock in which it began
        on = Signal()  # the last lane was on
        left = Signal(range(longest // self.lanes + 1))
        none_left = Signal()  # no whole clock left
        partial = Signal(self.lanes)  # lanes of the clock in which the allowance ends
        spent = Signal()
        carries_on = Signal()
        m.d.comb += carries_on.eq(on & lead2[-1])
        m.d.pulse += on.eq(lead2[-1] | tail2.any())
        with m.If(carries_on):
            m.d.pulse += [
                left.eq(left - 1),
                none_left.eq((left == 1) | none_left),
                spent.eq(none_left | spent),
            ]
        with m.Else():
            m.d.pulse += spent.eq(0)
            for i in lanes:
                remaining = longest - (self.lanes - i)
                clocks, ticks = divmod(remaining, self.lanes)
                with m.If(tail2[i]):
                    m.d.pulse += [
                        left.eq(clocks),
                        none_left.eq(clocks == 0),
                        partial.eq((1 << ticks) - 1),
                    ]
        keep3 = Signal(self.lanes)
        allowed = Mux(spent, 0, Mux(none_left, partial, -1))
        m.d.pulse += keep3.eq(Mux(on, ~lead2 | allowed, -1))
        return keep3

    def _duty(self, m: Module, demand1: Signal) -> Signal:
        """Whether the word goes beyond the duty limit; three clocks after `demand1`."""
        divisor = self.limits.duty_divisor
        over4 = Signal()
        if divisor == 1:
            return over4

        # 2: the word's change of level is a function of its lanes alone
        change2 = Signal(range(-self.lanes, (divisor - 1) * self.lanes + 1))
        with m.Switch(demand1):
            for pattern in range(1 << self.lanes):
                with m.Case(pattern):
                    m.d.pulse += change2.eq(divisor * pattern.bit_count() - self.lanes)

        # 3: the level; its bounds act on the way back, so that they are tests of one bit each
        level = self.duty_level
        below = level[-1]
        above = level[self.ceiling.bit_length() - 1] & ~below
        m.d.pulse += level.eq(Mux(below, 0, Mux(above, self.ceiling, level)) + change2)

        # 4
        m.d.pulse += over4.eq(level > self.threshold)
        return over4
