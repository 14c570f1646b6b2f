# SPDX-License-Identifier: Apache-2.0
"""Generates one pulse of one channel from its delay and width."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from .config import PulseConfig


class PulseSlot(wiring.Component):
    """Turns the train's time into the level of one pulse, one word of lanes per clock.

    The delay is compared in clocks; the trigger's phase is added to the lane, and a carry moves
    the start by one clock. Once begun, the pulse counts its own width and needs the train no
    more: it runs across the end of its train, and a swap of banks does not change it. A pulse
    that begins while the last one of the same slot is still on takes its place.

    Every stage is one or two LUTs deep: equality in pairs of bits, counters whose end is seen
    one step ahead. `settings` must hold still from before a train until its last pulse began.

    Members
    -------
    train : In
        See `PulseConfig.train_layout`.
    lit : In(1)
        The channel fires in this train.
    settings : In
        Delay and width for each bank.
    level : Out(lanes)
        Six clocks after the train's time.
    """

    latency = 6

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        super().__init__(
            {
                "train": In(config.train_layout),
                "lit": In(1),
                "settings": In(data.ArrayLayout(config.pulse_layout, 2)),
                "level": Out(config.lanes),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        log = self.config.lane_bits
        lanes = range(self.config.lanes)
        settings = self.settings

        # 1: the delay of the train's bank
        delay = Signal.like(settings[0].delay)
        time1 = Signal.like(self.train.time)
        phase1 = Signal.like(self.train.phase)
        open1 = Signal()
        bank1 = Signal()
        m.d.pulse += [
            delay.eq(Mux(self.train.bank, settings[1].delay, settings[0].delay)),
            time1.eq(self.train.time),
            phase1.eq(self.train.phase),
            open1.eq(self.train.live & self.lit),
            bank1.eq(self.train.bank),
        ]

        # 2: pairs of bits that are equal, the first while the train lives; the lane where the pulse
        # begins
        coarse = delay[log:]
        pairs = [slice(low, low + 2) for low in range(0, len(coarse), 2)]
        equal2 = Signal(len(pairs))
        begin2 = Signal(log + 1)
        bank2 = Signal()
        equal = [time1[pair] == coarse[pair] for pair in pairs]
        m.d.pulse += [
            equal2.eq(Cat(equal[0] & open1, *equal[1:])),
            begin2.eq(delay[:log] + phase1),
            bank2.eq(bank1),
        ]

        # 3: the clock of the delay is here
        now3 = Signal()
        next3 = Signal()
        begin3 = Signal(log)
        bank3 = Signal()
        hit = Signal()
        m.d.comb += hit.eq(equal2.all())
        m.d.pulse += [
            now3.eq(hit & ~begin2[log]),
            next3.eq(hit & begin2[log]),
            begin3.eq(begin2[:log]),
            bank3.eq(bank2),
        ]

        # 4: the pulse begins; its width. A carry waited one clock, with the bank of its train.
        carried = Signal()
        begin_carried = Signal(log)
        bank_carried = Signal()
        launch4 = Signal()
        begin4 = Signal(log)
        width4 = Signal(_width_layout(self.config))
        widths = [_describe(m, self.config, settings[bank].width) for bank in range(2)]
        bank = Signal()
        m.d.comb += bank.eq(Mux(now3, bank3, bank_carried))
        m.d.pulse += [
            carried.eq(next3),
            begin_carried.eq(begin3),
            bank_carried.eq(bank3),
            launch4.eq(now3 | carried),
            begin4.eq(Mux(now3, begin3, begin_carried)),
            width4.eq(Mux(bank, widths[1], widths[0])),
        ]

        # 5: lanes that are on from the launch, off from the end; the count of clocks between
        start = Signal(self.config.lanes)
        stop_at_once = Signal(self.config.lanes)
        stop = Signal(self.config.lanes)
        rest = Signal(self.config.lanes)
        count = Signal.like(width4.coarse)
        small = Signal()
        extra = Signal()
        active = Signal()
        ends = Signal()
        end = Signal(log + 1)
        short = Signal()
        m.d.comb += [
            ends.eq(active & small & (count[:2] == Mux(extra, 0, 1))),
            end.eq(begin4 + width4.fine),
            short.eq(width4.zero & ~end[log]),
        ]
        m.d.pulse += [
            *(start[i].eq(launch4 & (begin4 <= i)) for i in lanes),
            *(stop_at_once[i].eq(launch4 & short & (end[:log] <= i)) for i in lanes),
            # not a choice, of which synthesis would make a reset: those are the slowest wires
            stop.eq(rest & ends.replicate(self.config.lanes)),
            count.eq(count - 1),
            small.eq(count[2:] == 0),
        ]
        with m.If(ends):
            m.d.pulse += active.eq(0)
        with m.If(launch4):
            m.d.pulse += [
                *(rest[i].eq(end[:log] <= i) for i in lanes),
                count.eq(width4.coarse),
                small.eq(width4.small),
                extra.eq(end[log]),
                active.eq(~short),
            ]

        # 6: the level; a lane's four inputs fit one LUT
        last = self.level[-1]
        m.d.pulse += [
            self.level[i].eq(Mux(start[i], ~stop_at_once[i], last & ~stop[i])) for i in lanes
        ]
        return m


def _width_layout(config: PulseConfig) -> data.StructLayout:
    return data.StructLayout(
        {
            "fine": config.lane_bits,
            "coarse": config.width_bits - config.lane_bits,
            "zero": 1,  # no whole clock
            "small": 1,  # at most three
        }
    )


def _describe(m: Module, config: PulseConfig, width: Signal) -> data.View:
    """Split a width; what its comparisons give is at rest, and kept from being made later."""
    parts = Signal(_width_layout(config))
    coarse = width[config.lane_bits :]
    m.d.comb += [parts.fine.eq(width[: config.lane_bits]), parts.coarse.eq(coarse)]
    m.d.pulse += [parts.zero.eq(coarse == 0), parts.small.eq(coarse[2:] == 0)]
    return parts
