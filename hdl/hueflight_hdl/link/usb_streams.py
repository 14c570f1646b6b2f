# SPDX-License-Identifier: Apache-2.0
"""Converts between the streams of the camera and those of USB bulk endpoints."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import AsyncFIFO
from amaranth.lib.wiring import In, Out

from ..control.messages import REQUEST_BYTE, RESPONSE_BYTE, request_stream, response_stream
from .packet_word import WORD_LAYOUT

PACKET_BYTES = 512
"""Of a bulk endpoint at high speed."""
LINGER_CLOCKS = 7500
"""One microframe at 60 MHz: for so long the end of a packet waits for another that follows."""

BULK_BYTE = data.StructLayout({"data": 8, "last": 1})
"""A byte of a bulk transfer; `last` ends the transfer."""


class PacketBytes(wiring.Component):
    """Converts words to the bytes of a bulk transfer that ends when no further packet follows.

    If every frame ended a transfer, the host would get an interrupt for each; if transfers never
    ended, the last frame would be held back. So the last byte of a packet waits for the next
    packet, for at most `linger` clocks, and ends the transfer only if none came.

    Members
    -------
    words : In(stream)
    o : Out(stream)
        See `BULK_BYTE`.
    """

    def __init__(self, *, linger: int = LINGER_CLOCKS) -> None:
        self.linger = linger
        super().__init__(
            {
                "words": In(stream.Signature(WORD_LAYOUT)),
                "o": Out(stream.Signature(BULK_BYTE)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        word = Signal.like(self.words.payload)
        full = Signal()
        place = Signal(3)
        waited = Signal(range(self.linger + 1))
        ending, alone = Signal(), Signal()
        m.d.comb += [
            ending.eq(word.last & (place == 7)),
            alone.eq(waited == self.linger),
            self.o.payload.data.eq(word.data.word_select(place, 8)),
            self.o.payload.last.eq(ending & alone),
            self.o.valid.eq(full & (~ending | self.words.valid | alone)),
            self.words.ready.eq(~full | (self.o.valid & self.o.ready & (place == 7))),
        ]
        with m.If(self.o.valid & self.o.ready):
            m.d.usb += [place.eq(place + 1), waited.eq(0)]
            with m.If(place == 7):
                m.d.usb += full.eq(0)
        # once given up, the end stays an end even if a word comes while it waits to be taken
        with m.Elif(full & ending & ~self.words.valid & ~alone):
            m.d.usb += waited.eq(waited + 1)
        with m.If(self.words.valid & self.words.ready):
            m.d.usb += [word.eq(self.words.payload), full.eq(1)]
        return m


class ControlBytes(wiring.Component):
    """Control messages, one bulk packet each, between the clock of USB and that of the camera.

    Members
    -------
    received : In(stream), sent : Out(stream)
        Bytes of the bulk endpoints, in `usb`. A message ends with its packet, also with a full
        one that LUNA does not mark.
    requests : Out, responses : In
        See `control.messages`; in `sync`.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "received": In(stream.Signature(BULK_BYTE)),
                "sent": Out(stream.Signature(BULK_BYTE)),
                "requests": Out(request_stream()),
                "responses": In(response_stream()),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.inward = inward = AsyncFIFO(
            width=REQUEST_BYTE.size, depth=16, r_domain="sync", w_domain="usb"
        )
        m.submodules.outward = outward = AsyncFIFO(
            width=RESPONSE_BYTE.size, depth=16, r_domain="usb", w_domain="sync"
        )
        byte = data.View(REQUEST_BYTE, inward.w_data)
        count = Signal(range(PACKET_BYTES))
        over = Signal()
        m.d.comb += [
            byte.data.eq(self.received.payload.data),
            byte.end.eq(over),
            inward.w_en.eq(over | self.received.valid),
            self.received.ready.eq(inward.w_rdy & ~over),
            self.requests.payload.eq(inward.r_data),
            self.requests.valid.eq(inward.r_rdy),
            inward.r_en.eq(1),
            outward.w_data.eq(self.responses.payload),
            outward.w_en.eq(self.responses.valid),
            self.responses.ready.eq(outward.w_rdy),
            self.sent.payload.eq(outward.r_data),
            self.sent.valid.eq(outward.r_rdy),
            outward.r_en.eq(self.sent.ready),
        ]
        with m.If(over):
            with m.If(inward.w_rdy):
                m.d.usb += over.eq(0)
        with m.Elif(self.received.valid & inward.w_rdy):
            m.d.usb += count.eq(count + 1)
            with m.If(self.received.payload.last | (count == PACKET_BYTES - 1)):
                m.d.usb += [count.eq(0), over.eq(1)]
        return m
