# SPDX-License-Identifier: Apache-2.0
"""Fills in what is known last: sequence number, header check, packet length and CRC."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.wire import FRAME_HEADER

from ...link.packet_word import WORD_LAYOUT
from .packet_crc import PacketCrc

CHECKED_WORD_LAYOUT = data.StructLayout({"data": 64, "check": 1, "last": 1})
"""Word of an unfinished packet: ``check`` marks the last word of a header."""

SEQUENCE_WORD = FRAME_HEADER.offset("sequence") // 8
"""Word of every packet's header whose upper half is the sequence number."""


class TrailerWriter(wiring.Component):
    """Fills in the fields that depend on the whole packet; never waits.

    The sequence number goes into the upper half of the header's second word, the exclusive or
    of the header's other words into the upper half of its last, the packet's length and CRC
    into the packet's last word. These places must come as 0.

    Members
    -------
    i : In(stream)
        Words of packets, see `CHECKED_WORD_LAYOUT`; never waits.
    o : Out(stream)
        Words as they are sent, see `WORD_LAYOUT`; cannot wait.
    sequence : Out(32)
        Number of the next packet.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "i": In(stream.Signature(CHECKED_WORD_LAYOUT, always_ready=True)),
                "o": Out(stream.Signature(WORD_LAYOUT, always_ready=True)),
                "sequence": Out(32),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        word = self.i.payload
        low, high = word.data[:32], word.data[32:]

        # where in the packet we are
        number = Signal(31)  # of the word
        second = Signal()
        check = Signal(32)
        with m.If(self.i.valid):
            m.d.sync += [
                number.eq(Mux(word.last, 0, number + 1)),
                second.eq((number == SEQUENCE_WORD - 1) & ~word.last),
                self.sequence.eq(self.sequence + word.last),
                check.eq(Mux(word.last, 0, check ^ low ^ high)),
            ]
            with m.If(second):
                m.d.sync += check.eq(check ^ low ^ self.sequence)

        stamped = Signal(CHECKED_WORD_LAYOUT, reset_less=True)
        valid = Signal()
        m.d.sync += [valid.eq(self.i.valid), stamped.eq(word)]
        with m.If(second):
            m.d.sync += stamped.data[32:].eq(self.sequence)
        with m.If(word.check):
            m.d.sync += stamped.data[32:].eq(check ^ low)
        with m.If(word.last):
            m.d.sync += stamped.data[:32].eq((number + 1) << 1)

        m.submodules.crc = crc = PacketCrc()
        m.d.comb += [crc.valid.eq(valid), crc.word.eq(stamped.data), crc.last.eq(stamped.last)]
        for _ in range(crc.latency):
            later = Signal(CHECKED_WORD_LAYOUT, reset_less=True)
            valid_later = Signal()
            m.d.sync += [valid_later.eq(valid), later.eq(stamped)]
            valid, stamped = valid_later, later

        m.d.sync += [
            self.o.valid.eq(valid),
            self.o.payload.data.eq(stamped.data),
            self.o.payload.last.eq(stamped.last),
        ]
        with m.If(stamped.last):
            m.d.sync += self.o.payload.data[32:].eq(crc.value)
        return m
