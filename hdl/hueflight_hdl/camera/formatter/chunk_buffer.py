# SPDX-License-Identifier: Apache-2.0
"""The chunk buffer: keeps every chunk in both forms until its hits have been counted."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.memory import Memory, WritePort
from amaranth.lib.wiring import In, Out

from ..frame_format import GROUP, FrameFormat
from .bank_cursor import BankCursor, group_write_layout

WORD_BYTES = 8
"""Bytes of a bitmap that are read at once."""


class ChunkBuffer(wiring.Component):
    """Three memories side by side: all groups, packed groups of hits, bitmaps.

    Members
    -------
    groups : In(stream)
        Every group; never waits.
    packed : In(stream)
        Groups of hits from the packer; never waits.
    bank, place : In
        Where to read: a bank, and in it a group or a word of eight bitmap bytes.
    dense, hits, bitmap : Out
        What is there, two clocks later.
    clash : Out(3)
        The addressed word of dense, hits, bitmap is written in this clock. Builds rely on such a
        word never being used, which is formally verified with this output.
    """

    read_latency = 2

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        self.bitmap_words = -(-form.bank_groups // WORD_BYTES)
        super().__init__(
            {
                "groups": In(stream.Signature(form.group_layout, always_ready=True)),
                "packed": In(stream.Signature(group_write_layout(form), always_ready=True)),
                "bank": In(range(form.banks)),
                "place": In(range(form.bank_groups)),
                "dense": Out(form.codes_layout(GROUP)),
                "hits": Out(form.codes_layout(GROUP)),
                "bitmap": Out(8 * WORD_BYTES),
                "clash": Out(3),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form = self.form
        codes = form.codes_layout(GROUP)
        m.submodules.dense_memory = dense = Memory(
            shape=codes, depth=form.banks * form.bank_groups, init=[]
        )
        m.submodules.hits_memory = hits = Memory(
            shape=codes, depth=form.banks * form.bank_groups, init=[]
        )
        m.submodules.bitmap_memory = bitmap = Memory(
            shape=8 * WORD_BYTES, depth=form.banks * self.bitmap_words, init=[]
        )
        writes = [
            self._write_dense(m, dense),
            self._write_hits(m, hits),
            self._write_bitmap(m, bitmap),
        ]
        for number, (memory, out, places) in enumerate(
            (
                (dense, self.dense, form.bank_groups),
                (hits, self.hits, form.bank_groups),
                (bitmap, self.bitmap, self.bitmap_words),
            )
        ):
            # A bank is never written while it is read, which is formally verified; builds tell
            # the tools that the result of such a collision does not matter.
            port = memory.read_port()
            m.d.comb += [
                port.addr.eq(Cat(self.place[: (places - 1).bit_length()], self.bank)),
                self.clash[number].eq(writes[number].en & (writes[number].addr == port.addr)),
            ]
            # block memories are slow: nothing but a register behind them
            m.d.sync += out.eq(port.data)
        return m

    def _write_dense(self, m: Module, memory: Memory) -> WritePort:
        group = self.groups.payload
        cursor = BankCursor(self.form)
        cursor.advance(m, self.groups.valid, group.chunk_end | group.abort, group.abort, by=1)
        port = memory.write_port()
        address = Signal.like(port.addr, reset_less=True)
        codes = Signal(self.form.codes_layout(GROUP), reset_less=True)
        m.d.sync += [
            port.en.eq(self.groups.valid & ~group.abort),
            address.eq(Cat(cursor.place, cursor.bank)),
            codes.eq(group.codes),
        ]
        m.d.comb += [port.addr.eq(address), port.data.eq(codes)]
        return port

    def _write_hits(self, m: Module, memory: Memory) -> WritePort:
        packed = self.packed.payload
        port = memory.write_port()
        m.d.comb += [
            port.en.eq(self.packed.valid),
            port.addr.eq(Cat(packed.place, packed.bank)),
            port.data.eq(packed.codes),
        ]
        return port

    def _write_bitmap(self, m: Module, memory: Memory) -> WritePort:
        """Gather eight bytes of bitmap, or as many as the chunk has left, and write them."""
        group = self.groups.payload
        lit = Signal(GROUP)
        valid, end, abort = Signal(), Signal(), Signal()
        m.d.sync += [
            valid.eq(self.groups.valid),
            end.eq(group.chunk_end | group.abort),
            abort.eq(group.abort),
            *(lit[i].eq(group.codes[i].any()) for i in range(GROUP)),
        ]
        cursor = BankCursor(self.form)
        cursor.advance(m, valid, end, abort, by=1)
        byte = cursor.place[:3]
        word = Signal(data.ArrayLayout(8, WORD_BYTES), reset_less=True)
        full = Signal()
        m.d.comb += full.eq(end | (byte == WORD_BYTES - 1))
        port = memory.write_port()
        address = Signal.like(port.addr, reset_less=True)
        m.d.sync += [
            port.en.eq(valid & full & ~abort),
            address.eq(Cat(cursor.place[3:], cursor.bank)),
        ]
        for i in range(WORD_BYTES):
            with m.If(valid & (byte == i)):
                m.d.sync += word[i].eq(lit)
        m.d.comb += [port.addr.eq(address), port.data.eq(word)]
        return port
