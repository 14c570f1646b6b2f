# SPDX-License-Identifier: Apache-2.0
"""A filter for the trigger input: edges count only between levels that last."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out
from amaranth.utils import bits_for

from hueflight_protocol.illuminator_map import MAX_FILTER_TICKS

from .config import PulseConfig

_REACH = MAX_FILTER_TICKS - 1
"""Ticks on either side of a change in which there may be no other."""


def filter_latency(lanes: int, /) -> int:
    """Return the clocks that the filter takes from samples to their edge."""
    return _clocks_ahead(lanes) + 4


def _clocks_ahead(lanes: int) -> int:
    """Return the clocks that must have come after a sample."""
    return -(-_REACH // lanes)


class TriggerFilter(wiring.Component):
    """Finds the first edge in each clock whose levels before and after last long enough.

    With a width of W, an edge counts if the input does not change again for W ticks, and had not
    changed for W ticks before. The tick of an edge stays exact: it is the edge's own, and all
    edges are found the same number of clocks later.

    Members
    -------
    samples : In(lanes), before : In(1)
        Samples of the input, lane 0 earliest, and the last one of the clock before.
    falling : In(1)
        Falling edges count, not rising ones.
    width : In
        Ticks; 1 lets every edge pass, and values above `MAX_FILTER_TICKS` act as that.
    edge : Out(1), lane : Out
        `filter_latency` clocks after the samples.
    """

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        super().__init__(
            {
                "samples": In(config.lanes),
                "before": In(1),
                "falling": In(1),
                "width": In(bits_for(MAX_FILTER_TICKS)),
                "edge": Out(1),
                "lane": Out(config.lane_bits),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        count = self.config.lanes
        lanes = range(count)
        ahead = _clocks_ahead(count)
        within = Signal(_REACH)  # bit k: a change k + 1 ticks away forbids an edge
        m.d.pulse += [within[k].eq(self.width > k + 1) for k in range(_REACH)]

        # changes of the input, and the level after each; the oldest tick first
        ticks = _REACH + count * (1 + ahead)
        changes = Signal(ticks)
        levels = Signal(count * (1 + ahead), init=-1)
        m.d.pulse += [
            changes.eq(Cat(changes[count:], self.samples ^ Cat(self.before, self.samples)[:count])),
            levels.eq(Cat(levels[count:], self.samples)),
        ]

        # 1: is there another change near, in pairs of ticks; 2: in all; 3: the first edge
        edges = Signal(count)
        for lane in lanes:
            here = _REACH + lane
            near = [
                changes[here + sign * (k + 1)] & within[k]
                for k in range(_REACH)
                for sign in (1, -1)
            ]
            pairs = Signal(-(-len(near) // 2), name=f"pairs{lane}")
            alone = Signal(name=f"alone{lane}")
            wanted = Signal(2, name=f"wanted{lane}")
            m.d.pulse += [
                *(pairs[i].eq(Cat(near[2 * i : 2 * i + 2]).any()) for i in range(len(pairs))),
                wanted.eq(Cat(changes[here] & (levels[lane] ^ self.falling), wanted)),
                alone.eq(~pairs.any()),
            ]
            m.d.comb += edges[lane].eq(alone & wanted[1])
        m.d.pulse += self.edge.eq(edges.any())
        for lane in reversed(lanes):
            with m.If(edges[lane]):
                m.d.pulse += self.lane.eq(lane)
        return m
