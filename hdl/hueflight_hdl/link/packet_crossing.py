# SPDX-License-Identifier: Apache-2.0
"""A queue for packet words between the clock of the formatter and that of a link."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.fifo import AsyncFIFO
from amaranth.lib.wiring import In, Out

from .packet_word import WORD_LAYOUT


class PacketCrossing(wiring.Component):
    """A queue of words between two clock domains.

    Parameters
    ----------
    domain : str
        Of the link; words come in `sync`.
    depth : int
        Words of eight bytes, a power of two.

    Members
    -------
    packets : In(stream)
        From the formatter.
    words : Out(stream)
        In `domain`.
    level : Out
        Number of words that were waiting one clock ago, in `domain`.
    """

    def __init__(self, *, domain: str, depth: int) -> None:
        self.domain = domain
        self.depth = depth
        super().__init__(
            {
                "packets": In(stream.Signature(WORD_LAYOUT)),
                "words": Out(stream.Signature(WORD_LAYOUT)),
                "level": Out(range(depth + 1)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.queue = queue = AsyncFIFO(
            width=self.packets.payload.shape().size,
            depth=self.depth,
            r_domain=self.domain,
            w_domain="sync",
        )
        m.d.comb += [
            queue.w_data.eq(self.packets.payload),
            queue.w_en.eq(self.packets.valid),
            self.packets.ready.eq(queue.w_rdy),
            self.words.payload.eq(queue.r_data),
            self.words.valid.eq(queue.r_rdy),
            queue.r_en.eq(self.words.ready),
        ]
        m.d[self.domain] += self.level.eq(queue.r_level)
        return m
