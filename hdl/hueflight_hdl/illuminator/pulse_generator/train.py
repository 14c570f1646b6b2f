# SPDX-License-Identifier: Apache-2.0
"""Decides which triggers begin a train, and counts the time in the train."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from .config import MIN_SPACING, PERIOD_BITS, PulseConfig


class Train(wiring.Component):
    """Serves or ignores each trigger and distributes the state of the running train.

    A train takes over bank, mask and marker as they are in the clock after its trigger, and runs
    for the whole clocks of the bank's period. While it runs, triggers are ignored, or begin it
    anew (`restart`); within `MIN_SPACING` clocks of a served trigger all are ignored.

    Members
    -------
    edge : In(1), lane : In
        A trigger.
    restart : In(1)
        A trigger during a train begins a new one.
    periods : In
        Length of a train in ticks, for each bank.
    bank, mask, marker : In
        For the next train.
    train : Out
        See `PulseConfig.train_layout`; two clocks after the edge.
    mask_out, marker_out : Out
        Of the running train.
    served, ignored, restarted : Out(1)
        High for one clock, one clock after the edge.
    swapped : Out(1)
        The bank is not the last train's; two clocks after the edge.
    busy : Out(1)
        A train is running.
    """

    latency = 2

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        self.left = Signal(PERIOD_BITS - config.lane_bits)  # clocks until the train's last two,
        self.loads = Signal()  # to be taken in this clock
        self.length = Signal.like(self.left)  # from here
        super().__init__(
            {
                "edge": In(1),
                "lane": In(config.lane_bits),
                "restart": In(1),
                "periods": In(data.ArrayLayout(PERIOD_BITS, 2)),
                "bank": In(1),
                "mask": In(config.channels),
                "marker": In(8),
                "train": Out(config.train_layout),
                "mask_out": Out(config.channels),
                "marker_out": Out(8),
                "served": Out(1),
                "ignored": Out(1),
                "restarted": Out(1),
                "swapped": Out(1),
                "busy": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        log = self.config.lane_bits

        # 1: serve or ignore
        busy = Signal()
        spaced = Signal(init=1)
        accept = Signal()
        lane1 = Signal(log)
        m.d.comb += [
            accept.eq(self.edge & (~busy | (self.restart & spaced))),
            self.busy.eq(busy),
        ]
        m.d.pulse += [
            self.served.eq(accept),
            self.ignored.eq(self.edge & ~accept),
            self.restarted.eq(accept & busy),
            lane1.eq(self.lane),
        ]

        # how long it is busy; `periods` is at rest, and so are the lengths in clocks. The count
        # begins two clocks after the edge, from a register, so that little hangs on `accept` and
        # on the bank; and its end is seen two steps ahead, so that little stands between `busy` and
        # itself.
        lengths = [self._clocks_less_two(m, self.periods[bank]) for bank in range(2)]
        count = self.left
        near, ending = Signal(), Signal()
        spacing = Signal(range(MIN_SPACING))
        m.d.pulse += [
            self.length.eq(Mux(self.bank, lengths[1], lengths[0])),
            self.loads.eq(self.served),
            count.eq(Mux(self.loads, self.length, count - 1)),
            near.eq((count == 4) & ~self.served & ~self.loads),
            ending.eq(near & ~self.served),
        ]
        with m.If(ending & ~self.served):
            m.d.pulse += busy.eq(0)
        with m.If(spacing != 0):
            m.d.pulse += spacing.eq(spacing - 1)
        with m.If(spacing == 1):
            m.d.pulse += spaced.eq(1)
        with m.If(accept):
            m.d.pulse += [busy.eq(1), spaced.eq(0)]
        with m.If(self.served):
            m.d.pulse += spacing.eq(MIN_SPACING - 2)

        # 2: the broadcast
        time = self.train.time
        m.d.pulse += [self.swapped.eq(0), time.eq(time + 1)]
        with m.If(self.served):
            m.d.pulse += [
                time.eq(0),
                self.train.live.eq(1),
                self.train.phase.eq(lane1),
                self.train.bank.eq(self.bank),
                self.mask_out.eq(self.mask),
                self.marker_out.eq(self.marker),
                self.swapped.eq(self.bank ^ self.train.bank),
            ]
        with m.Elif(time.all()):
            m.d.pulse += self.train.live.eq(0)
        return m

    def _clocks_less_two(self, m: Module, period: Signal) -> Signal:
        whole = period[self.config.lane_bits :]
        clocks = Signal.like(whole)
        m.d.pulse += clocks.eq(Mux(whole < MIN_SPACING, MIN_SPACING, whole) - 2)
        return clocks
