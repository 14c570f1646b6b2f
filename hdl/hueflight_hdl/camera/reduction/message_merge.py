# SPDX-License-Identifier: Apache-2.0
"""Two sources of packets for one formatter."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..formatter.piece_reader import MESSAGE_LAYOUT


class MessageMerge(wiring.Component):
    """Passes on whole packets of two sources; what the first has goes before the second.

    Members
    -------
    first, second : In(stream), o : Out(stream)
        See `MESSAGE_LAYOUT`.
    """

    def __init__(self) -> None:
        words = stream.Signature(MESSAGE_LAYOUT)
        super().__init__({"first": In(words), "second": In(words), "o": Out(words)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        decided, second_before, second = Signal(), Signal(), Signal()
        m.d.comb += [
            second.eq(Mux(decided, second_before, ~self.first.valid)),
            self.o.valid.eq(Mux(second, self.second.valid, self.first.valid)),
            self.o.payload.eq(Mux(second, self.second.payload, self.first.payload)),
            self.first.ready.eq(self.o.ready & ~second),
            self.second.ready.eq(self.o.ready & second),
        ]
        with m.If(self.o.valid):
            m.d.sync += [
                decided.eq(~(self.o.ready & self.o.payload.last)),
                second_before.eq(second),
            ]
        return m
