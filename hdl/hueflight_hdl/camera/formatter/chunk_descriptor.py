# SPDX-License-Identifier: Apache-2.0
"""Chunk descriptors: what the reader must know of a chunk before its first byte is sent."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out
from amaranth.utils import bits_for

from ..frame_format import GROUP, ChunkFormat, FrameFormat, tail_bytes
from .hit_packer import tally_layout


class ChunkDescriber(wiring.Component):
    """Chooses the form of a chunk from its number of hits, and computes its size.

    It takes two clocks, in which the packer's last group reaches the chunk buffer.

    Members
    -------
    i : In(stream)
        Tallies; never waits.
    o : Out(stream)
        Descriptors, see `descriptor_layout`; cannot wait.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        super().__init__(
            {
                "i": In(stream.Signature(tally_layout(form), always_ready=True)),
                "o": Out(stream.Signature(descriptor_layout(form), always_ready=True)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form = self.form
        inner, last = form.chunk(last=False), form.chunk(last=True)
        tally = self.i.payload

        valid = Signal()
        first = Signal(descriptor_layout(form), reset_less=True)
        pixels_end = tally.frame_end & ~tally.abort
        m.d.sync += [
            valid.eq(self.i.valid),
            first.hits.eq(tally.hits),
            first.some.eq(tally.hits.any() & ~tally.abort),
            first.dense.eq(
                Mux(pixels_end, tally.hits >= last.dense_from, tally.hits >= inner.dense_from)
            ),
            first.final.eq((tally.hits - 1) >> 3),
            first.tail.eq(_tail(tally.hits, form.code_bits)),
            first.short.eq(pixels_end),
            first.end.eq(tally.frame_end | tally.abort),
            first.abort.eq(tally.abort),
        ]
        m.d.sync += [self.o.valid.eq(valid), self.o.payload.eq(first)]
        for chunk, short in ((inner, 0), (last, 1)):
            with m.If(first.dense & (first.short == short)):
                m.d.sync += _dense(self.o.payload, chunk)
        return m


def _dense(descriptor: data.View, chunk: ChunkFormat) -> list:
    return [
        descriptor.final.eq(chunk.groups - 1),
        descriptor.tail.eq(tail_bytes(chunk.pixels, chunk.code_bits)),
    ]


def _tail(hits: Value, code_bits: int) -> Value:
    """Return the bytes that the last of the packed groups takes."""
    sizes = data.ArrayLayout(bits_for(code_bits), GROUP)
    table = sizes.const([tail_bytes(hits or GROUP, code_bits) for hits in range(GROUP)])
    return table[hits[:3]]


def descriptor_layout(form: FrameFormat, /) -> data.StructLayout:
    """Return the layout of a chunk's description."""
    return data.StructLayout(
        {
            "hits": form.hit_bits,
            "some": 1,  # there is something to send
            "dense": 1,
            "final": range(form.bank_groups),  # place of the last group of codes
            "tail": range(form.code_bits + 1),  # bytes of the last group
            "short": 1,  # the sizes are those of a frame's last chunk
            "end": 1,  # of the frame
            "abort": 1,  # no chunk, just the end
        }
    )
