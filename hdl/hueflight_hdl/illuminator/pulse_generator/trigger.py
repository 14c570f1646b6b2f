# SPDX-License-Identifier: Apache-2.0
"""Sources of triggers: the oversampled external input and an internal timer."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .config import MIN_SPACING, PulseConfig

START_CLOCKS = 8
"""More than the geared inputs take from configuration to the first true sample."""


class ExternalTrigger(wiring.Component):
    """Finds the first rising (or falling) edge in each clock, and its lane.

    Further edges in the same clock are ignored, and so are all in the first `START_CLOCKS` after
    configuration: an input that is high from the beginning has no edge.

    Members
    -------
    samples : In(lanes)
        From the geared input: asynchronous, lane 0 earliest.
    falling : In(1)
        Edges of the other direction count.
    edge : Out(1)
        Three clocks after the sample.
    lane : Out
    level : Out(1)
        Of the input.
    samples_out : Out(lanes), before_out : Out(1)
        Of the clock, without metastability, and the last sample of the clock before; for the
        filter, two clocks after the input.
    """

    latency = 3

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        super().__init__(
            {
                "samples": In(config.lanes),
                "falling": In(1),
                "edge": Out(1),
                "lane": Out(config.lane_bits),
                "level": Out(1),
                "samples_out": Out(config.lanes),
                "before_out": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        lanes = range(self.config.lanes)
        settled = Signal(self.config.lanes)  # a second register: the first may be metastable
        samples = Signal(self.config.lanes, init=-1)
        last = Signal(init=1)
        started = Signal(START_CLOCKS)
        edges = Signal(self.config.lanes)
        m.d.pulse += [
            settled.eq(self.samples),
            started.eq(Cat(1, started)),
            samples.eq(Mux(started[-1], settled, -1)),
            last.eq(samples[-1]),
            self.edge.eq(edges.any()),
        ]
        m.d.comb += [
            *(
                edges[i].eq((now ^ before) & (now ^ self.falling))
                for i, now, before in zip(lanes, samples, [last, *samples[:-1]], strict=True)
            ),
            self.level.eq(last),
            self.samples_out.eq(samples),
            self.before_out.eq(last),
        ]
        for i in reversed(lanes):
            with m.If(edges[i]):
                m.d.pulse += self.lane.eq(i)
        return m


class InternalTrigger(wiring.Component):
    """A trigger with a period in ticks, which need not be whole clocks.

    Periods below `MIN_SPACING` clocks are taken as that.

    Members
    -------
    enable : In(1)
        Runs while high; begins anew in lane 0.
    period : In(16)
        Ticks.
    edge : Out(1)
    lane : Out
    """

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        super().__init__(
            {
                "enable": In(1),
                "period": In(16),
                "edge": Out(1),
                "lane": Out(config.lane_bits),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        log = self.config.lane_bits
        shortest = MIN_SPACING << log
        period = Signal(16)
        too_short = Signal()
        m.d.pulse += [
            too_short.eq(self.period[log + 3 :] == 0),
            period.eq(Mux(too_short, shortest, self.period)),
        ]
        # `count` is loaded with the clock of an edge; the next comes `count` clocks later, or
        # one more where the lanes carry
        count = Signal(16 - log)
        small = Signal()
        carry = Signal()
        upcoming = Signal(log)
        due = Signal()
        m.d.comb += due.eq(small & (count[:2] == Mux(carry, 0, 1)))
        m.d.pulse += [
            self.edge.eq(0),
            count.eq(count - 1),
            small.eq(count[2:] == 0),
            carry.eq((self.lane + period[:log])[log]),
        ]
        with m.If(~self.enable):
            m.d.pulse += [count.eq(MIN_SPACING), small.eq(0), upcoming.eq(0)]
        with m.Elif(due):
            m.d.pulse += [
                self.edge.eq(1),
                count.eq(period[log:]),
                small.eq(0),
                self.lane.eq(upcoming),
                upcoming.eq(upcoming + period[:log]),
            ]
        return m
