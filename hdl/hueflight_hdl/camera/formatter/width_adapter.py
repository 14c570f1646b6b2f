# SPDX-License-Identifier: Apache-2.0
"""Joins pieces of any number of bytes into words of eight bytes."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

WORD_BYTES = 8


class WidthAdapter(wiring.Component):
    """Joins pieces end to end; the caller decides where each begins and when a word is full.

    A piece is rotated to where the one before it ended and merged with what is held; what
    goes past the end of the word is held in its place. Bytes of a piece beyond its size must
    be 0 if the next piece does not begin right behind it.

    Members
    -------
    valid : In(1)
        There is a piece, or a word to be drained.
    piece : In
        Bytes, the first in the low bits.
    position : In(3)
        Bytes of the word that are held already.
    full : In(1)
        A word is complete with this piece.
    drain : In(1)
        No piece: what is held is a word already.
    o_valid : Out(1)
        Two clocks later.
    word : Out(64)
        Eight bytes, the first in the low bits.
    """

    latency = 2

    def __init__(self, piece_bytes: int) -> None:
        self.piece_bytes = piece_bytes
        super().__init__(
            {
                "valid": In(1),
                "piece": In(8 * piece_bytes),
                "position": In(3),
                "full": In(1),
                "drain": In(1),
                "o_valid": Out(1),
                "word": Out(8 * WORD_BYTES),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # 1: rotate; two words' worth if a piece can be longer than a word
        row = data.ArrayLayout(8, WORD_BYTES)
        parts = -(-self.piece_bytes // WORD_BYTES)
        rotated = [Signal(row, name=f"rotated{i}", reset_less=True) for i in range(parts)]
        for i in range(parts):
            piece = self.piece[64 * i : 64 * (i + 1)]
            m.d.sync += rotated[i].eq(_rotate(piece, self.position))
        valid, full, drain = Signal(), Signal(), Signal()
        held_places = Signal(WORD_BYTES)
        m.d.sync += [
            valid.eq(self.valid),
            full.eq(self.full),
            drain.eq(self.drain),
            *(held_places[j].eq(self.position > j) for j in range(WORD_BYTES)),
        ]

        # 2: merge. Word k of the sum takes its low places from part k-1, wrapped, and the
        # rest from part k.
        held = Signal(row, reset_less=True)
        # Seven bytes and a piece of nine make two words; only a longer piece goes past them.
        beyond = Signal(row if self.piece_bytes > 9 else 0, reset_less=True)
        merged = [Signal(row, name=f"merged{i}") for i in range(parts + 1)]
        for j in range(WORD_BYTES):
            for i in range(parts + 1):
                low = held[j] if i == 0 else rotated[i - 1][j]
                high = rotated[i][j] if i < parts else Const(0, 8)
                m.d.comb += merged[i][j].eq(Mux(held_places[j], low, high))
        m.d.sync += [self.o_valid.eq(valid & full), self.word.eq(Mux(drain, held, merged[0]))]
        with m.If(valid):
            with m.If(drain):
                m.d.sync += held.eq(beyond)
            with m.Elif(full):
                m.d.sync += held.eq(merged[1])
            with m.Else():
                m.d.sync += held.eq(merged[0])
            if self.piece_bytes > 9:
                m.d.sync += beyond.eq(merged[2])
        return m


def _rotate(piece: Value, by: Value) -> Value:
    """Return the bytes of `piece` moved up by `by` places, the last ones wrapped."""
    whole = Cat(piece, Const(0, 64 - len(piece)))
    for bit in range(3):
        turned = Cat(whole[64 - (8 << bit) :], whole[: 64 - (8 << bit)])
        whole = Mux(by[bit], turned, whole)
    return whole
