# SPDX-License-Identifier: Apache-2.0
"""One LED channel: combines its pulse slots and applies the limits."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from .config import PulseConfig
from .limiter import OutputLimiter
from .slot import PulseSlot


class Channel(wiring.Component):
    """Drives one LED in every train whose mask contains the channel.

    Members
    -------
    train : In
        See `PulseConfig.train_layout`.
    selected : In(1)
        The train's mask has this channel.
    enable : In(2)
        The channel fires, for each bank.
    pulses : In
        Settings, ``[bank][pulse]``.
    armed : In(1)
        The LED is off without it, one clock later.
    level : Out(lanes)
    on_limited, duty_limited : Out(1)
        The limiter shortened a pulse in this clock.
    """

    latency = 1 + PulseSlot.latency + 1 + OutputLimiter.latency

    def __init__(self, config: PulseConfig, index: int) -> None:
        self.config = config
        self.index = index
        bank = data.ArrayLayout(config.pulse_layout, config.pulses)
        super().__init__(
            {
                "train": In(config.train_layout),
                "selected": In(1),
                "enable": In(2),
                "pulses": In(data.ArrayLayout(bank, 2)),
                "armed": In(1),
                "level": Out(config.lanes),
                "on_limited": Out(1),
                "duty_limited": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # the channel's own copy of the train, so that no net spans all channels
        train = Signal(self.config.train_layout)
        lit = Signal()
        m.d.pulse += [
            train.eq(self.train),
            lit.eq(self.selected & Mux(self.train.bank, self.enable[1], self.enable[0])),
        ]
        slots = []
        for number in range(self.config.pulses):
            slot = PulseSlot(self.config)
            m.submodules[f"slot{number}"] = slot
            m.d.comb += [
                slot.train.eq(train),
                slot.lit.eq(lit),
                *(slot.settings[bank].eq(self.pulses[bank][number]) for bank in range(2)),
            ]
            slots.append(slot)

        limiter = OutputLimiter(self.config.limit(self.index), lanes=self.config.lanes)
        m.submodules.limiter = limiter
        merged = slots[0].level
        for slot in slots[1:]:
            merged = merged | slot.level
        m.d.pulse += limiter.demand.eq(merged)
        m.d.comb += [
            limiter.allow.eq(self.armed),
            self.level.eq(limiter.level),
            self.on_limited.eq(limiter.on_limited),
            self.duty_limited.eq(limiter.duty_limited),
        ]
        return m
