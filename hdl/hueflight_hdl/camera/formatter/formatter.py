# SPDX-License-Identifier: Apache-2.0
"""The frame formatter: turns codes from the sensor into finished packets."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, fifo, stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped
from amaranth.utils import ceil_log2

from hueflight_protocol.wire import FrameFlags

from ...link.packet_word import WORD_LAYOUT
from ..frame_format import INFO_LAYOUT, FormatError, FrameFormat
from .admission import FrameAdmission
from .chunk_buffer import ChunkBuffer
from .chunk_descriptor import ChunkDescriber, descriptor_layout
from .frame_header import header_words
from .group_assembler import GroupAssembler
from .hit_packer import HitPacker
from .piece_reader import MESSAGE_LAYOUT, PIECE_LAYOUT, PieceReader, Source
from .pixel_filter import FILTER_LAYOUT, MASK_WORD, PixelFilter
from .trailer import TrailerWriter
from .width_adapter import WORD_BYTES, WidthAdapter

MIN_BUFFER_WORDS = 32


class FrameFormatter(wiring.Component):
    """Turns codes into frame packets, bit for bit as `hueflight_protocol.encode_frame`.

    Parameters
    ----------
    form : FrameFormat
        Geometry, code width, lanes, run length, banks.
    buffer_words : int
        Words of eight bytes between the formatter and the link, a power of two from 32 up.

    Members
    -------
    beats : In(stream)
        Codes in readout order, `lanes` at a time. What is beyond the last pixel of a frame in
        its last beat is ignored.
    abort : In(1)
        Give up the frame in progress: its packet ends and says so. No beat is taken.
    info : In
        See `INFO_LAYOUT`; taken over with a frame's first beat. Flags of the filters are added.
    filters : In
        See `FILTER_LAYOUT`; held through a frame.
    mask_address, mask_data : Out, In
        The pixel mask's memory, see `PixelFilter`.
    messages : In(stream)
        Packets that are not frames; sent between frames. See `MESSAGE_LAYOUT`.
    o : Out(stream)
        Packets, see `WORD_LAYOUT`.
    ends : Out(1)
        The next beat is its frame's last.
    begins : Out(1)
        A frame's first beat is taken.
    in_frame : Out(1)
        Some but not all of a frame's beats have been taken.
    sending : Out(1)
        A frame's packet is not finished yet.
    sent, sent_aborted : Out(1)
        A frame's packet has been finished, whole or aborted.
    hits : Out(32)
        Hits in it.
    sequence : Out(32)
        Number of the next packet.
    room : Out
        Words that the buffer can still take.
    banks_free : Out
        Chunks that the banks can still take.
    clash : Out(1)
        An address was read and written in the same clock; formally verified never to happen.
    """

    def __init__(self, form: FrameFormat, *, buffer_words: int = 512) -> None:
        if buffer_words < MIN_BUFFER_WORDS or buffer_words & (buffer_words - 1):
            raise FormatError(
                f"buffer_words = {buffer_words}: must be a power of two from {MIN_BUFFER_WORDS} up"
            )
        self.form = form
        self.buffer_words = buffer_words
        super().__init__(
            {
                "beats": In(stream.Signature(form.codes_layout(form.lanes))),
                "abort": In(1),
                "info": In(INFO_LAYOUT),
                "filters": In(FILTER_LAYOUT),
                "mask_address": Out(ceil_log2(-(-form.pixels // MASK_WORD))),
                "mask_data": In(MASK_WORD),
                "messages": In(stream.Signature(MESSAGE_LAYOUT)),
                "o": Out(stream.Signature(WORD_LAYOUT)),
                "ends": Out(1),
                "begins": Out(1),
                "in_frame": Out(1),
                "sending": Out(1),
                "sent": Out(1),
                "sent_aborted": Out(1),
                "hits": Out(32),
                "sequence": Out(32),
                "room": Out(range(buffer_words + 1)),
                "banks_free": Out(range(form.banks + 1)),
                "clash": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form = self.form
        # names of submodules are kept: placement on the ULX3S depends on the names in the netlist
        m.submodules.front = admission = FrameAdmission(form)
        m.submodules.filter = pixel_filter = PixelFilter(form)
        m.submodules.group = groups = GroupAssembler(form)
        m.submodules.packer = packer = HitPacker(form)
        m.submodules.store = chunk_buffer = ChunkBuffer(form)
        m.submodules.describe = descriptor = ChunkDescriber(form)
        m.submodules.reader = reader = PieceReader(form)

        # write side: from the admission on, nothing waits
        connect(m, flipped(self.beats), admission.i)
        connect(m, admission.o, pixel_filter.i)
        connect(m, pixel_filter.o, groups.i)
        connect(m, packer.o, chunk_buffer.packed)
        connect(m, packer.tally, descriptor.i)
        for sink in (packer.i, chunk_buffer.groups):
            m.d.comb += [sink.valid.eq(groups.o.valid), sink.payload.eq(groups.o.payload)]
        m.d.comb += [
            admission.abort.eq(self.abort),
            admission.freed.eq(reader.freed),
            pixel_filter.settings.eq(self.filters),
            pixel_filter.hold.eq(admission.hold),
            self.mask_address.eq(pixel_filter.mask_address),
            pixel_filter.mask_data.eq(self.mask_data),
            self.ends.eq(admission.ends),
            self.banks_free.eq(admission.banks_free),
            self.begins.eq(admission.begins),
            self.in_frame.eq(admission.in_frame),
        ]
        info = self._info(m, admission, pixel_filter, reader)

        # every bank has at most one descriptor, and two frames can be aborted
        layout = descriptor_layout(form)
        m.submodules.chunks = chunks = fifo.SyncFIFOBuffered(
            width=layout.size, depth=2 * form.banks + 1
        )
        m.d.comb += [
            chunks.w_data.eq(descriptor.o.payload),
            chunks.w_en.eq(descriptor.o.valid),
            reader.chunks.payload.eq(chunks.r_data),
            reader.chunks.valid.eq(chunks.r_rdy),
            chunks.r_en.eq(reader.chunks.ready),
        ]

        # read side: nothing behind the reader ever waits
        connect(m, flipped(self.messages), reader.messages)
        m.d.comb += [
            chunk_buffer.bank.eq(reader.bank),
            chunk_buffer.place.eq(reader.place),
            self.sent.eq(reader.ended & ~reader.aborted),
            self.sent_aborted.eq(reader.ended & reader.aborted),
            self.hits.eq(reader.hits),
        ]
        self._watch(m, reader, chunk_buffer)
        trailer = self._words(m, reader, chunk_buffer, info)
        self._buffer(m, reader, trailer)
        return m

    def _info(
        self, m: Module, admission: FrameAdmission, pixel_filter: PixelFilter, reader: PieceReader
    ) -> data.View:
        """Keep the new frame's header until it is sent."""
        info = Signal(INFO_LAYOUT, reset_less=True)
        pending, sending = Signal(), Signal()
        m.d.comb += [
            reader.begun.eq(pending),
            admission.header_free.eq(~pending),
            self.sending.eq(pending | sending),
        ]
        with m.If(reader.ended):
            m.d.sync += sending.eq(0)
        with m.If(reader.header_sent):
            m.d.sync += [pending.eq(0), sending.eq(1)]
        with m.If(admission.begins):
            flags = [FrameFlags.MASKED, FrameFlags.ROI, FrameFlags.GATED]
            done = sum(
                (Mux(pixel_filter.on[i], flag.value, 0) for i, flag in enumerate(flags)),
                start=Signal(16),
            )
            m.d.sync += [pending.eq(1), info.eq(self.info), info.flags.eq(self.info.flags | done)]
        return info

    def _watch(self, m: Module, reader: PieceReader, chunk_buffer: ChunkBuffer) -> None:
        """Detect pieces that were written in the clock of their read; for verification only."""
        before = Signal.like(chunk_buffer.clash)
        piece = reader.o.payload
        sources = (Source.DENSE, Source.HITS, Source.BITMAP)
        fetched = Cat(piece.source == source for source in sources)
        m.d.sync += before.eq(chunk_buffer.clash)
        m.d.comb += self.clash.eq(reader.o.valid & ~piece.drain & (before & fetched).any())

    def _words(
        self, m: Module, reader: PieceReader, chunk_buffer: ChunkBuffer, info: data.View
    ) -> TrailerWriter:
        """Fetch pieces, put them end to end, and complete packets."""
        form = self.form
        m.submodules.funnel = adapter = WidthAdapter(max(form.code_bits, WORD_BYTES))
        m.submodules.sealer = trailer = TrailerWriter()

        # The reader's piece is what it asked for one clock ago. 1: what is not in the chunk_buffer
        valid, piece = reader.o.valid, reader.o.payload
        direct = Signal(64, reset_less=True)
        with m.Switch(piece.source):
            with m.Case(Source.HEADER):
                m.d.sync += direct.eq(header_words(form, info)[piece.word])
            with m.Case(Source.MESSAGE):
                m.d.sync += direct.eq(reader.message)
            with m.Case(Source.CHUNK_WORD):
                m.d.sync += direct.eq(reader.chunk_word)
            with m.Case(Source.END_WORDS):
                m.d.sync += direct.eq(reader.end_words)
            with m.Default():
                m.d.sync += direct.eq(0)
        valid, piece = _later(m, valid, piece)

        # 2: pieces that are
        fetched = Signal(8 * adapter.piece_bytes, reset_less=True)
        with m.Switch(piece.source):
            with m.Case(Source.BITMAP):
                m.d.sync += fetched.eq(chunk_buffer.bitmap)
            with m.Case(Source.DENSE):
                m.d.sync += fetched.eq(chunk_buffer.dense)
            with m.Case(Source.HITS):
                m.d.sync += fetched.eq(chunk_buffer.hits)
            with m.Default():
                m.d.sync += fetched.eq(direct)
        valid, piece = _later(m, valid, piece)

        # 3, 4: bytes into words
        m.d.comb += [
            adapter.valid.eq(valid),
            adapter.piece.eq(fetched),
            adapter.position.eq(piece.position),
            adapter.full.eq(piece.full),
            adapter.drain.eq(piece.drain),
        ]
        for _ in range(adapter.latency):
            valid, piece = _later(m, valid, piece)
        m.d.comb += [
            trailer.i.valid.eq(adapter.o_valid),
            trailer.i.payload.data.eq(adapter.word),
            trailer.i.payload.check.eq(piece.check),
            trailer.i.payload.last.eq(piece.last),
            self.sequence.eq(trailer.sequence),
        ]
        return trailer

    def _buffer(self, m: Module, reader: PieceReader, trailer: TrailerWriter) -> None:
        """Hold words for the link; room is counted when a word is asked for, not when it comes."""
        # a power of two in memory, and one in the output register
        m.submodules.buffer = buffer = fifo.SyncFIFOBuffered(
            width=WORD_LAYOUT.size, depth=self.buffer_words + 1
        )
        room = Signal(range(self.buffer_words + 1), init=self.buffer_words)
        leaves = Signal()
        m.d.comb += [
            buffer.w_data.eq(trailer.o.payload),
            buffer.w_en.eq(trailer.o.valid),
            self.o.payload.eq(buffer.r_data),
            self.o.valid.eq(buffer.r_rdy),
            buffer.r_en.eq(self.o.ready),
            leaves.eq(self.o.valid & self.o.ready),
            self.room.eq(room),
        ]
        # the reader looks at a room that is two pieces old
        m.d.sync += [
            room.eq(room + leaves - (reader.o.valid & reader.o.payload.full)),
            reader.room.eq(room >= 3),
        ]


def _later(m: Module, valid: Signal, piece: data.View) -> tuple[Signal, data.View]:
    """Return a piece one clock later."""
    valid_after, after = Signal(), Signal(PIECE_LAYOUT, reset_less=True)
    m.d.sync += [valid_after.eq(valid), after.eq(piece)]
    return valid_after, after
