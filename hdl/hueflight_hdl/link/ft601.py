# SPDX-License-Identifier: Apache-2.0
"""USB 3 through FTDI's FT601: packets are written into its FIFO in bursts.

# Ref: FTDI DS_FT600Q-FT601Q, FT600Q-FT601Q IC Datasheet: 245 synchronous FIFO mode, write timing.
"""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from .packet_crossing import PacketCrossing
from .packet_word import WORD_LAYOUT

QUEUE_WORDS = 512
BURST_WORDS = 128
"""A kilobyte, one packet of USB 3: shorter bursts would fill its queue with short packets."""
LINGER_CLOCKS = 12_500
"""An eighth of a millisecond at 100 MHz: for so long words wait for a full burst."""


class Ft601Bursts(wiring.Component):
    """Writes words to the pins of an FT601, in its clock domain `ft`.

    A burst begins when `burst` words are available, or some have waited for `linger` clocks, and
    continues until none is left. Every output is a register; `txe_n` goes straight to their
    enable, because a word counts as taken exactly in the clocks in which `wr_n` and `txe_n` are
    both low.

    Members
    -------
    words : In(stream), level : In
        From a `PacketCrossing`.
    data : Out(32), be : Out(4), wr_n : Out(1), txe_n : In(1)
        Pins; a word of eight bytes goes out in two halves, the first bytes first.
    """

    def __init__(
        self, *, depth: int = QUEUE_WORDS, burst: int = BURST_WORDS, linger: int = LINGER_CLOCKS
    ) -> None:
        self.burst = burst
        self.linger = linger
        super().__init__(
            {
                "words": In(stream.Signature(WORD_LAYOUT)),
                "level": In(range(depth + 1)),
                "data": Out(32),
                "be": Out(4),
                "wr_n": Out(1, init=1),
                "txe_n": In(1, init=1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        running, enough, late, second = Signal(), Signal(), Signal(), Signal()
        waited = Signal(range(self.linger + 1))
        free, give = Signal(), Signal()
        m.d.ft += [enough.eq(self.level >= self.burst), late.eq(waited == self.linger)]
        m.d.comb += [
            free.eq(self.wr_n | ~self.txe_n),
            give.eq(running & self.words.valid),
            self.be.eq(0xF),
            self.words.ready.eq(free & running & second),
        ]
        with m.If(running | ~self.words.valid):
            m.d.ft += waited.eq(0)
        with m.Elif(waited != self.linger):
            m.d.ft += waited.eq(waited + 1)
        with m.If(~self.words.valid):
            m.d.ft += running.eq(0)
        with m.Elif(enough | late):
            m.d.ft += running.eq(1)
        with m.If(free):
            m.d.ft += self.wr_n.eq(~give)
            with m.If(give):
                m.d.ft += [
                    self.data.eq(self.words.payload.data.word_select(second, 32)),
                    second.eq(~second),
                ]
        return m


class Ft601Link(wiring.Component):
    """Packets from the domain `sync` to an FT601.

    Members
    -------
    packets : In(stream)
        In `sync`.
    data, be, wr_n, txe_n
        Pins, as in `Ft601Bursts`, in the domain `ft`.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "packets": In(stream.Signature(WORD_LAYOUT)),
                "data": Out(32),
                "be": Out(4),
                "wr_n": Out(1, init=1),
                "txe_n": In(1, init=1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.crossing = crossing = PacketCrossing(domain="ft", depth=QUEUE_WORDS)
        m.submodules.bursts = bursts = Ft601Bursts()
        connect(m, flipped(self.packets), crossing.packets)
        connect(m, crossing.words, bursts.words)
        m.d.comb += [
            bursts.level.eq(crossing.level),
            bursts.txe_n.eq(self.txe_n),
            self.data.eq(bursts.data),
            self.be.eq(bursts.be),
            self.wr_n.eq(bursts.wr_n),
        ]
        return m
