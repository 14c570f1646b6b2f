# SPDX-License-Identifier: Apache-2.0
"""Sequences the pieces of packets: decides in each clock which piece is fetched next.

The size of every piece is known before it is fetched, so the position of each byte is decided
here and the data path behind never stalls. A piece is only begun while the link's
buffer has room for a word.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, enum, stream, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.layout import BitLayout
from hueflight_protocol.wire import CHUNK_WORD, END_WORD, ChunkKind, TrailerStatus

from ..frame_format import ChunkFormat, FrameFormat
from .chunk_buffer import WORD_BYTES
from .chunk_descriptor import descriptor_layout
from .frame_header import HEADER_WORDS


class Source(enum.Enum, shape=3):
    """Source of a piece."""

    ZERO = 0
    HEADER = 1
    MESSAGE = 2
    CHUNK_WORD = 3
    END_WORDS = 4
    BITMAP = 5
    DENSE = 6
    HITS = 7


PIECE_LAYOUT = data.StructLayout(
    {
        "source": Source,
        "word": range(HEADER_WORDS),  # of the header
        "position": 3,  # bytes of the word that are there before the piece
        "full": 1,  # a word is complete with it
        "drain": 1,  # no piece, a word is complete already
        "check": 1,  # the word holds the header's check
        "last": 1,  # the word is the packet's last
    }
)
"""One clock's work for the data path."""

MESSAGE_LAYOUT = data.StructLayout({"data": 64, "check": 1, "last": 1})
"""Eight bytes of a packet that is not a frame: the last word of its header is marked
``check``, its trailer ``last``; what `TrailerWriter` fills in is left 0."""


class PieceReader(wiring.Component):
    """Sends header, chunks and trailer of each frame, and messages between frames.

    Members
    -------
    begun : In(1)
        A frame has begun; held until `header_sent`.
    header_sent : Out(1)
        The header has been fetched.
    chunks : In(stream)
        Descriptors, of empty chunks too.
    freed : Out(1)
        The oldest bank has been read; a clock after its last piece was begun.
    messages : In(stream)
        Packets that are not frames, word by word, see `MESSAGE_LAYOUT`.
    room : In(1)
        There is room for at least three more words.
    o : Out(stream)
        Pieces; cannot wait.
    bank, place : Out
        Where in the store the piece is.
    chunk_word, end_words, message : Out
        The pieces that are not in the store, one clock after theirs.
    hits : Out(32)
        Hits of the frame so far.
    ended : Out(1)
        A frame packet has ended.
    aborted : Out(1)
        It says that it is aborted.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        super().__init__(
            {
                "begun": In(1),
                "header_sent": Out(1),
                "chunks": In(stream.Signature(descriptor_layout(form))),
                "freed": Out(1),
                "messages": In(stream.Signature(MESSAGE_LAYOUT)),
                "room": In(1),
                "o": Out(stream.Signature(PIECE_LAYOUT, always_ready=True)),
                "bank": Out(range(form.banks)),
                "place": Out(range(form.bank_groups)),
                "chunk_word": Out(32),
                "end_words": Out(64),
                "message": Out(64),
                "hits": Out(32),
                "ended": Out(1),
                "aborted": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        wanted = Signal()  # the state has a piece
        size = Signal(range(max(self.form.code_bits, WORD_BYTES) + 1))
        align = Signal()  # the next piece begins at a multiple of four bytes
        piece = Signal(PIECE_LAYOUT)
        half, whole = Signal(), Signal(init=1)  # what is not in a full word yet
        go = self._place(m, half, whole, wanted, size, align, piece)
        self._sequence(m, half, whole, go, wanted, size, align, piece)
        return m

    def _place(
        self,
        m: Module,
        half: Signal,
        whole: Signal,
        wanted: Signal,
        size: Signal,
        align: Signal,
        piece: data.View,
    ) -> Signal:
        """Settle where a piece goes; return whether it is taken now."""
        fill, filled = Signal(5), Signal(5)  # bytes that are not in a full word yet
        drain, go = Signal(), Signal()
        total, end = Signal(5), Signal(5)
        m.d.comb += [
            go.eq(wanted & self.room & ~drain),
            total.eq(fill[:3] + size),
            end.eq(Mux(align, (total + 3) & ~3, total)),
            filled.eq(fill),
        ]
        with m.If(go):
            m.d.comb += filled.eq(Mux(end >= WORD_BYTES, end - WORD_BYTES, end))
        with m.Elif(drain & self.room):
            m.d.comb += filled.eq(fill - WORD_BYTES)
        # what `fill` says is known with it, since all of a clock's work hangs on it
        m.d.sync += [
            fill.eq(filled),
            drain.eq(Mux(go, end[4], Mux(drain & self.room, fill[4], drain))),
            # what is held of half a word has 0 behind it, see `WidthAdapter`
            half.eq((filled[:3] == 4) & ~filled[3:].any()),
            whole.eq((filled[:3] == 0) & ~filled[3:].any()),
        ]
        m.d.sync += [
            self.o.valid.eq((wanted | drain) & self.room),
            self.o.payload.eq(piece),
            self.o.payload.position.eq(fill),
            self.o.payload.full.eq(drain | (end >= WORD_BYTES)),
            self.o.payload.drain.eq(drain),
        ]
        with m.If(drain):
            m.d.sync += [self.o.payload.check.eq(0), self.o.payload.last.eq(0)]
        return go

    def _sequence(
        self,
        m: Module,
        half: Signal,
        whole: Signal,
        go: Signal,
        wanted: Signal,
        size: Signal,
        align: Signal,
        piece: data.View,
    ) -> None:
        """Step from piece to piece."""
        form = self.form
        chunk = self.chunks.payload
        inner, last = form.chunk(last=False), form.chunk(last=True)

        word = Signal(range(HEADER_WORDS))
        place = Signal(range(form.bank_groups))
        codes = Signal(descriptor_layout(form), reset_less=True)  # the chunk being sent
        index, sent = Signal(14), Signal(16)
        aborted = Signal()
        frame_before = Signal()  # the last packet was a frame: a message has precedence
        left = Signal.like(place)  # pieces of this bitmap, or of these codes, after this one
        ends = Signal()  # there are none
        length = Signal.like(size)  # of this one
        bitmap_final, bitmap_rest = _bitmap_sizes(inner, last, chunk.short)
        bitmap_tail = Signal(4)
        m.d.comb += [
            self.place.eq(place),
            piece.word.eq(word),
        ]
        # what comes from the next bank is a chunk's word later at least
        freed = Signal()
        m.d.sync += [
            self.message.eq(self.messages.payload.data),
            self.freed.eq(freed),
            self.bank.eq(self.bank + self.freed),
        ]

        def begin(final: Value, whole: int, tail: Value) -> None:
            m.d.sync += [place.eq(0), left.eq(final), ends.eq(final == 0)]
            m.d.sync += length.eq(Mux(final == 0, tail, whole))

        def go_on(whole: int, tail: Value) -> None:
            m.d.sync += [place.eq(place + 1), left.eq(left - 1), ends.eq(left == 1)]
            m.d.sync += length.eq(Mux(left == 1, tail, whole))

        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [index.eq(0), sent.eq(0), self.hits.eq(0)]
                with m.If(self.messages.valid & (frame_before | ~self.begun)):
                    m.next = "MESSAGE"
                with m.Elif(self.begun):
                    m.next = "HEADER"
            with m.State("MESSAGE"):
                m.d.comb += [
                    wanted.eq(self.messages.valid),
                    self.messages.ready.eq(go),
                    size.eq(WORD_BYTES),
                    piece.source.eq(Source.MESSAGE),
                    piece.check.eq(self.messages.payload.check),
                    piece.last.eq(self.messages.payload.last),
                ]
                with m.If(go & piece.last):
                    m.d.sync += frame_before.eq(0)
                    m.next = "IDLE"
            with m.State("HEADER"):
                m.d.comb += [
                    wanted.eq(1),
                    size.eq(WORD_BYTES),
                    piece.source.eq(Source.HEADER),
                    piece.check.eq(word == HEADER_WORDS - 1),
                ]
                with m.If(go):
                    m.d.sync += word.eq(word + 1)
                    with m.If(piece.check):
                        m.d.comb += self.header_sent.eq(1)
                        m.next = "CHUNK"
            with m.State("CHUNK"):
                m.d.comb += [
                    wanted.eq(self.chunks.valid & chunk.some),
                    size.eq(4),
                    piece.source.eq(Source.CHUNK_WORD),
                    self.chunks.ready.eq(go | ~chunk.some),
                ]
                with m.If(self.chunks.valid & self.chunks.ready):
                    m.d.sync += [
                        codes.eq(chunk),
                        aborted.eq(chunk.abort),
                        index.eq(index + 1),
                        sent.eq(sent + chunk.some),
                        bitmap_tail.eq(bitmap_rest),
                        self.chunk_word.eq(_chunk_word(chunk, index)),
                    ]
                    with m.If(chunk.some):
                        m.d.sync += self.hits.eq(self.hits + chunk.hits)
                        with m.If(chunk.dense):
                            begin(chunk.final, form.code_bits, chunk.tail)
                            m.next = "CODES"
                        with m.Else():
                            begin(bitmap_final, WORD_BYTES, bitmap_rest)
                            m.next = "BITMAP"
                    with m.Else():
                        m.d.comb += freed.eq(~chunk.abort)
                        with m.If(chunk.end):
                            m.next = "PAD"
            with m.State("BITMAP"):
                m.d.comb += [
                    wanted.eq(1),
                    size.eq(length),
                    piece.source.eq(Source.BITMAP),
                ]
                with m.If(go):
                    go_on(WORD_BYTES, bitmap_tail)
                    with m.If(ends):
                        begin(codes.final, form.code_bits, codes.tail)
                        m.next = "CODES"
            with m.State("CODES"):
                m.d.comb += [
                    wanted.eq(1),
                    size.eq(length),
                    align.eq(ends),
                    piece.source.eq(Mux(codes.dense, Source.DENSE, Source.HITS)),
                ]
                with m.If(go):
                    go_on(form.code_bits, codes.tail)
                    with m.If(ends):
                        m.d.comb += freed.eq(1)
                        with m.If(codes.end):
                            m.next = "PAD"
                        with m.Else():
                            m.next = "CHUNK"
            with m.State("PAD"):
                m.d.comb += [wanted.eq(half), size.eq(4), piece.source.eq(Source.ZERO)]
                with m.If(go | whole):
                    m.next = "END"
            with m.State("END"):
                m.d.comb += [wanted.eq(1), size.eq(WORD_BYTES), piece.source.eq(Source.END_WORDS)]
                with m.If(go):
                    m.next = "SEAL"
            with m.State("SEAL"):
                m.d.comb += [
                    wanted.eq(1),
                    size.eq(WORD_BYTES),
                    piece.source.eq(Source.ZERO),
                    piece.last.eq(1),
                ]
                with m.If(go):
                    m.d.comb += self.ended.eq(1)
                    m.d.sync += frame_before.eq(1)
                    m.next = "IDLE"
        m.d.comb += [
            self.aborted.eq(aborted),
            self.end_words.eq(Cat(_end_word(sent, aborted), self.hits)),
        ]


def _bitmap_sizes(inner: ChunkFormat, last: ChunkFormat, short: Value) -> tuple[Value, Value]:
    """Return the place of a bitmap's last word, and the bytes in it."""
    final, rest = zip(*(divmod(chunk.bitmap_bytes - 1, 8) for chunk in (inner, last)), strict=True)
    return Mux(short, final[1], final[0]), Mux(short, rest[1] + 1, rest[0] + 1)


def _chunk_word(chunk: data.View, index: Value) -> Value:
    kind = Mux(chunk.dense, ChunkKind.DENSE.value, ChunkKind.BITMAP.value)
    return _word(CHUNK_WORD, kind=kind, index=index, hits=chunk.hits)


def _end_word(chunks: Value, aborted: Value) -> Value:
    status = Mux(aborted, TrailerStatus.ABORTED.value, 0)
    return _word(END_WORD, kind=Const(ChunkKind.END.value), status=status, chunks=chunks)


def _word(layout: BitLayout, **values: Value) -> Value:
    """Return the word that holds `values` in the fields of `layout`."""
    wide = {field.name: values[field.name] | Const(0, field.width) for field in layout.fields}
    return Cat(wide[field.name][: field.width] for field in layout.fields)
