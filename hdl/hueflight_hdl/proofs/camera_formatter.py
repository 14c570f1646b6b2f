# SPDX-License-Identifier: Apache-2.0
"""Properties of the frame formatter, for all codes, pauses, aborts and changes of filters."""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.hdl import Assert, Assume, Cat, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In

from hueflight_protocol.wire import ChunkKind, TrailerStatus, dense_bytes

from ..camera.formatter.chunk_buffer import WORD_BYTES
from ..camera.formatter.formatter import MIN_BUFFER_WORDS, FrameFormatter
from ..camera.formatter.frame_header import HEADER_WORDS
from ..camera.formatter.packet_crc import PacketCrc
from ..camera.formatter.piece_reader import PieceReader
from ..camera.formatter.pixel_filter import FILTER_LAYOUT, MASK_WORD
from ..camera.formatter.trailer import CHECKED_WORD_LAYOUT, TrailerWriter
from ..camera.frame_format import GROUP, INFO_LAYOUT, FrameFormat

SMALL = FrameFormat(rows=1, cols=16, code_bits=5, lanes=8, run=8, banks=2)
"""One beat a chunk, chunks of both kinds, of half words and of whole ones; two banks."""


@dataclass(frozen=True)
class Fetched:
    """What comes from the memories of chunks."""

    dense: Signal
    hits: Signal
    bitmap: Signal


class OpenFormatter(FrameFormatter):
    """A formatter with nothing behind its words, and anything in its memories of chunks.

    There is room for a word in any clock or none, and what is fetched of a chunk is any bytes.
    That is more than any buffer, link and memory do, so what holds here holds with them.

    Members
    -------
    has_room, fetched
        Set from outside.
    valid, word
        Words before sequence number, length and CRC are filled in.
    """

    def __init__(self, form: FrameFormat) -> None:
        super().__init__(form, buffer_words=MIN_BUFFER_WORDS)
        self.has_room = Signal()
        codes = form.codes_layout(GROUP)
        self.fetched = Fetched(Signal(codes), Signal(codes), Signal(8 * WORD_BYTES))
        self.valid = Signal()
        self.word = Signal(CHECKED_WORD_LAYOUT)

    def _words(
        self, m: Module, reader: PieceReader, chunk_buffer: object, info: data.View
    ) -> TrailerWriter:
        return super()._words(m, reader, self.fetched, info)

    def _buffer(self, m: Module, reader: PieceReader, trailer: TrailerWriter) -> None:
        m.d.comb += [
            reader.room.eq(self.has_room),
            self.valid.eq(trailer.i.valid),
            self.word.eq(trailer.i.payload),
        ]


class FormatterHarness(wiring.Component):
    """A formatter whose inputs do anything; there are no messages.

    Parameters
    ----------
    formatter : FrameFormatter
    """

    def __init__(self, formatter: FrameFormatter) -> None:
        self.formatter = formatter
        self.form = form = formatter.form
        super().__init__(
            {
                "codes": In(form.lanes * form.code_bits),
                "offered": In(1),
                "abort": In(1),
                "info": In(INFO_LAYOUT),
                "filters": In(FILTER_LAYOUT),
                "mask": In(MASK_WORD),
                "take": In(1),
                "fetched": In(2 * GROUP * form.code_bits + 8 * WORD_BYTES),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.formatter = formatter = self.formatter
        m.d.comb += [
            formatter.beats.valid.eq(self.offered),
            formatter.beats.payload.eq(self.codes),
            formatter.abort.eq(self.abort),
            formatter.info.eq(self.info),
            formatter.filters.eq(self.filters),
            formatter.mask_data.eq(self.mask),
        ]
        self.state(m)
        return m

    def state(self, m: Module) -> None:
        """Add assertions."""


class StableHarness(FormatterHarness):
    """A word that waits for the link does not change."""

    def __init__(self) -> None:
        super().__init__(FrameFormatter(SMALL, buffer_words=MIN_BUFFER_WORDS))

    def state(self, m: Module) -> None:
        """Compare with the clock before."""
        out = self.formatter.o
        waited = Signal()
        word = Signal.like(out.payload)
        m.d.comb += out.ready.eq(self.take)
        m.d.sync += [waited.eq(out.valid & ~out.ready), word.eq(out.payload)]
        with m.If(waited):
            m.d.comb += [Assert(out.valid), Assert(out.payload.as_value() == word.as_value())]


class OpenHarness(FormatterHarness):
    """A formatter with nothing behind it; `take` is room for a word."""

    formatter: OpenFormatter

    def __init__(self) -> None:
        super().__init__(OpenFormatter(SMALL))

    def elaborate(self, platform: object) -> Module:
        m = super().elaborate(platform)
        fetched = self.formatter.fetched
        m.d.comb += [
            self.formatter.has_room.eq(self.take),
            Cat(fetched.dense, fetched.hits, fetched.bitmap).eq(self.fetched),
        ]
        return m


WALK_BITS = 5


class WalkHarness(OpenHarness):
    """Every packet ends just where a walk over its chunks says."""

    def state(self, m: Module) -> None:
        """Walk the packets, half a word at a time."""
        taken, last = self.formatter.valid, self.formatter.word.last
        word = self.formatter.word.data
        number = Signal(4)  # of the header's words, and the first one behind them
        # no wider than `SMALL` needs, for the solver's sake; what is compared is whole
        left = Signal(WALK_BITS)  # halves of the present chunk
        index, chunks, hits = (Signal(WALK_BITS) for _ in range(3))
        trailer = Signal()  # the next word is the packet's last
        body = Signal()
        m.d.comb += body.eq((number == HEADER_WORDS) & ~trailer)

        walk = _Walk(self.form, left, index, chunks, hits)
        low, ends = walk.step(m, "low", taken & body, word[:32])
        high, _ = low.step(m, "high", taken & body & ~ends, word[32:])
        with m.If(taken):
            m.d.comb += Assert(last == trailer)
            m.d.comb += Assert(self.formatter.word.check == (number == HEADER_WORDS - 1))
            with m.If(number != HEADER_WORDS):
                m.d.sync += number.eq(number + 1)
            with m.If(trailer):
                m.d.comb += Assert(word == 0)  # length and CRC are filled in
                m.d.sync += [number.eq(0), trailer.eq(0)]
                m.d.sync += [left.eq(0), index.eq(0), chunks.eq(0), hits.eq(0)]
            with m.Elif(body):
                m.d.sync += [
                    left.eq(high.left),
                    index.eq(high.index),
                    chunks.eq(high.chunks),
                    hits.eq(high.hits),
                ]
                with m.If(ends):
                    m.d.comb += [
                        Assert(word[2:16] & ~TrailerStatus.ABORTED.value == 0),
                        Assert(word[16:32] == chunks),
                        Assert(word[32:] == hits),
                    ]
                    m.d.sync += trailer.eq(1)


class SteadyWalkHarness(WalkHarness):
    """The same with room in every clock, which lets the solver look further."""

    def state(self, m: Module) -> None:
        """Never wait."""
        super().state(m)
        m.d.comb += Assume(self.take)


class _Walk:
    """Where a walk stands: halves of a word left of a chunk, and totals."""

    def __init__(
        self, form: FrameFormat, left: Value, index: Value, chunks: Value, hits: Value
    ) -> None:
        self.form = form
        self.left, self.index, self.chunks, self.hits = left, index, chunks, hits

    def step(self, m: Module, name: str, active: Value, half: Value) -> tuple[_Walk, Value]:
        """Go over half a word; return where that leads, and whether the end word is here."""
        form = self.form
        kind, index, hits = half[:2], half[2:16], half[16:]
        inner, last = form.chunk(last=False), form.chunk(last=True)
        in_last = index == form.chunks - 1
        bits = (hits[: form.hit_bits] * form.code_bits + 7) >> 3
        bitmap = [(bits + chunk.bitmap_bytes + 3) >> 2 for chunk in (inner, last)]
        dense = [dense_bytes(chunk.pixels, form.code_bits) >> 2 for chunk in (inner, last)]
        sizes = [Mux(kind == ChunkKind.DENSE, d, b) for d, b in zip(dense, bitmap, strict=True)]
        dense_from = Mux(in_last, last.dense_from, inner.dense_from)
        ends = Signal(name=f"{name}_ends")
        begins = Signal(name=f"{name}_begins")
        m.d.comb += [
            ends.eq(active & (self.left == 0) & (kind == ChunkKind.END)),
            begins.eq(
                active & (self.left == 0) & ((kind == ChunkKind.BITMAP) | (kind == ChunkKind.DENSE))
            ),
        ]
        with m.If(active & (self.left == 0)):
            if name == "high":
                m.d.comb += Assert(kind != ChunkKind.END)
                with m.If(kind == ChunkKind.PAD):
                    m.d.comb += Assert(half == 0)
            else:
                m.d.comb += Assert(kind != ChunkKind.PAD)
        with m.If(begins):
            m.d.comb += [
                Assert(index >= self.index),
                Assert(index < form.chunks),
                Assert(hits != 0),
                Assert(hits <= Mux(in_last, last.pixels, inner.pixels)),
                Assert((kind == ChunkKind.DENSE) == (hits >= dense_from)),
            ]
        after = _Walk(
            form,
            Signal(WALK_BITS, name=f"{name}_left"),
            Signal(WALK_BITS, name=f"{name}_index"),
            Signal(WALK_BITS, name=f"{name}_chunks"),
            Signal(WALK_BITS, name=f"{name}_hits"),
        )
        goes_on = Mux(self.left == 0, 0, self.left - 1)
        m.d.comb += [
            after.left.eq(Mux(begins, Mux(in_last, sizes[1], sizes[0]), goes_on)),
            after.index.eq(Mux(begins, index + 1, self.index)),
            after.chunks.eq(self.chunks + begins),
            after.hits.eq(self.hits + Mux(begins, hits, 0)),
        ]
        return after, ends


class CollisionHarness(OpenHarness):
    """What is fetched from a chunk's memories is not written in the same clock."""

    def state(self, m: Module) -> None:
        """Nothing but the formatter's own watch."""
        m.d.comb += Assert(~self.formatter.clash)


class ProgressHarness(OpenHarness):
    """With room for every word, what has come leaves; nothing of it is left over."""

    CLOCKS = 34
    """Clocks after the last beat, more than a packet takes."""

    def state(self, m: Module) -> None:
        """Count the clocks in which nothing comes and there is room."""
        formatter = self.formatter
        quiet = Signal(range(self.CLOCKS + 1))
        comes = formatter.beats.valid & formatter.beats.ready
        with m.If(comes | formatter.in_frame | ~self.take):
            m.d.sync += quiet.eq(0)
        with m.Elif(quiet != self.CLOCKS):
            m.d.sync += quiet.eq(quiet + 1)
        with m.If(quiet == self.CLOCKS):
            m.d.comb += [
                Assert(~formatter.sending),
                Assert(~formatter.valid),
                Assert(formatter.banks_free == self.form.banks),
            ]


class TrailerHarness(wiring.Component):
    """The trailer writer passes on every word once, and fills in the packet's length."""

    def __init__(self) -> None:
        super().__init__({"valid": In(1), "word": In(CHECKED_WORD_LAYOUT)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.trailer = trailer = TrailerWriter()
        m.d.comb += [trailer.i.valid.eq(self.valid), trailer.i.payload.eq(self.word)]
        latency = PacketCrc.latency + 2
        coming = Signal(latency)  # words on their way, and whether they are the last ones
        ends = Signal(latency)
        m.d.sync += [
            coming.eq(coming << 1 | self.valid),
            ends.eq(ends << 1 | (self.valid & self.word.last)),
        ]
        halves = Signal(32)  # of words in the packet so far
        out = trailer.o
        m.d.comb += Assert(out.valid == coming[-1])
        with m.If(out.valid):
            m.d.comb += Assert(out.payload.last == ends[-1])
            m.d.sync += halves.eq(halves + 2)
            with m.If(out.payload.last):
                m.d.comb += Assert(out.payload.data[:32] == halves + 2)
                m.d.sync += halves.eq(0)
        return m
