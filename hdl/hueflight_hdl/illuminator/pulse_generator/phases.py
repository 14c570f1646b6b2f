# SPDX-License-Identifier: Apache-2.0
"""Statistics of the lanes in which external triggers arrive."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ...common.fast_counter import FastCounter
from .config import PulseConfig


class PhaseStatistics(wiring.Component):
    """Last, smallest and largest phase, and a count for each.

    Members
    -------
    event : In(1), lane : In
        A trigger was served.
    clear : In(1)
    last, smallest, largest : Out
    valid : Out(1)
        There was an event since cleared.
    counts : Out
        Saturating, for each lane.
    saturated : Out(1)
    """

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        lane = config.lane_bits
        super().__init__(
            {
                "event": In(1),
                "lane": In(lane),
                "clear": In(1),
                "last": Out(lane),
                "smallest": Out(lane),
                "largest": Out(lane),
                "valid": Out(1),
                "counts": Out(data.ArrayLayout(32, config.lanes)),
                "saturated": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        with m.If(self.event):
            m.d.pulse += [self.last.eq(self.lane), self.valid.eq(1)]
            with m.If(~self.valid | (self.lane < self.smallest)):
                m.d.pulse += self.smallest.eq(self.lane)
            with m.If(~self.valid | (self.lane > self.largest)):
                m.d.pulse += self.largest.eq(self.lane)
        with m.If(self.clear):
            m.d.pulse += [
                self.valid.eq(0),
                self.last.eq(0),
                self.smallest.eq(0),
                self.largest.eq(0),
            ]
        full = Signal(self.config.lanes)
        for lane in range(self.config.lanes):
            counter = FastCounter()
            m.submodules[f"count{lane}"] = counter
            hit = Signal()
            m.d.pulse += hit.eq(self.event & (self.lane == lane))
            m.d.comb += [
                counter.event.eq(hit),
                counter.clear.eq(self.clear),
                self.counts[lane].eq(counter.value),
                full[lane].eq(counter.saturated),
            ]
        m.d.pulse += self.saturated.eq(full.any())
        return m
