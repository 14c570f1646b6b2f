# SPDX-License-Identifier: Apache-2.0
"""Stores the pulses of both banks in the form that the pulse slots need."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.registers import ADDRESS_BITS, WORD_BITS, Register

from ...control.register_file import register_layout
from .config import PulseConfig


class ScheduleStore(wiring.Component):
    """Flip-flops for delay and width of every pulse, in the domain `sync`.

    A width beyond what the generator tells apart is kept as the widest: it is cut in any case.

    Parameters
    ----------
    config : PulseConfig
    register : Register
        The map's ``pulse``.

    Members
    -------
    written : In(1), address : In(16), word : In(32)
        See `RegisterFile`.
    pulses : Out
        ``[bank][channel][pulse]``, see `PulseConfig.pulse_layout`.
    """

    def __init__(self, config: PulseConfig, register: Register) -> None:
        self.config = config
        self.register = register
        banks = data.ArrayLayout(config.bank_layout["pulses"].shape, 2)
        super().__init__(
            {
                "written": In(1),
                "address": In(ADDRESS_BITS),
                "word": In(WORD_BITS),
                "pulses": Out(banks),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        element = register_layout(self.register)
        for _ in self.register.count:
            element = element.elem_shape
        word = data.View(element, self.word[: element.size])
        kept = Signal(self.config.pulse_layout)
        m.d.comb += [
            kept.delay.eq(word.delay),
            kept.width.eq(
                Mux(word.width[self.config.width_bits :].any(), self.config.widest, word.width)
            ),
        ]
        for bank, channel, pulse in self.register.elements():
            address = self.register.address_of(bank, channel, pulse)
            with m.If(self.written & (self.address == address)):
                m.d.sync += self.pulses[bank][channel][pulse].eq(kept)
        return m
