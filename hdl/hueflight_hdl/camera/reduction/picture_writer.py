# SPDX-License-Identifier: Apache-2.0
"""Packets of sums, each from a block of pixels whose window of frames is over.

A packet's header states how long it is and how many of its pixels are saturated. So each block is
read twice: once to count, once to send. A packet is handed on as a whole, at a word per clock, so
that frames never wait for sums that are still being packed.
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, fifo, stream, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.errors import HueflightError
from hueflight_protocol.reduction_registers import ReductionRoom
from hueflight_protocol.wire import PACKET_HEADER, SUMS_BODY, PacketType

from ..formatter.piece_reader import MESSAGE_LAYOUT
from ..frame_format import FrameFormat
from ..messages import record_words
from .settings import WIDTH_BITS, settings_layout
from .windows import BlockPlan, block_layout

WORD_BITS = 64
PACK_CLOCKS = 2
"""Clocks after which the last words of a packet are on their way to the buffer."""
LEVEL_CLOCKS = 2
"""Clocks by which the buffer's level is old."""


HEAD_WORDS = PACKET_HEADER.size // 8 + SUMS_BODY.size // 8
"""Words of a packet before the widths of its sums."""


def plan_blocks(form: FrameFormat, room: ReductionRoom, packet_words: int, /) -> BlockPlan:
    """Divide the pixels of a frame into blocks, each as large as a packet can hold.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    room : ReductionRoom
        Sums per pixel and their bits.
    packet_words : int
        Words of eight bytes in a packet, at most.

    Returns
    -------
    BlockPlan
        The blocks, whatever part of the room is in use.

    Raises
    ------
    HueflightError
        If a packet has no room for a group of pixels, or the number of words is no power of two.
    """
    spare = packet_words - HEAD_WORDS - -(-room.sums // 8) - 1
    groups = spare * WORD_BITS // sum(room.widths) // form.lanes
    if groups < 1 or packet_words & (packet_words - 1):
        raise HueflightError(
            f"packet_words = {packet_words}: must be a power of two with room for {form.lanes} "
            f"pixels of {room.sums} sums of {room.sum_bits} bits"
        )
    return BlockPlan(-(-form.pixels // form.lanes), groups)


class SumPacker(wiring.Component):
    """Puts numbers of any width end to end; never waits.

    Members
    -------
    valid, value, width : In
        A number, less than 2**width; at most as wide as `value`.
    flush : In(1)
        Fill up the last word with 0, if any is begun. No number.
    o_valid, word : Out
        A word, the first number in its low bits; a clock later.
    """

    def __init__(self, bits: int) -> None:
        self.bits = bits
        super().__init__(
            {
                "valid": In(1),
                "value": In(bits),
                "width": In(WIDTH_BITS),
                "flush": In(1),
                "o_valid": Out(1),
                "word": Out(WORD_BITS),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # 1: moved to where the number before it ended
        fill = Signal(range(WORD_BITS))
        end = Signal(range(2 * WORD_BITS))
        moved = Signal(WORD_BITS + self.bits, reset_less=True)
        full, keep = Signal(), Signal()
        m.d.comb += end.eq(fill + self.width)
        m.d.sync += [moved.eq(self.value << fill), full.eq(0), keep.eq(0)]
        with m.If(self.valid):
            m.d.sync += [fill.eq(end), full.eq(end >= WORD_BITS), keep.eq(1)]
        with m.Elif(self.flush):
            m.d.sync += [fill.eq(0), full.eq(fill != 0), moved.eq(0), keep.eq(1)]

        # 2: merged with what is held
        held, merged = Signal(WORD_BITS), Signal(WORD_BITS)
        m.d.comb += [
            merged.eq(held | moved[:WORD_BITS]),
            self.o_valid.eq(full),
            self.word.eq(merged),
        ]
        with m.If(keep):
            m.d.sync += held.eq(Mux(full, moved[WORD_BITS:], merged))
        return m


class PictureWriter(wiring.Component):
    """Turns blocks into packets, bit for bit as `hueflight_protocol.encode_sums`.

    Parameters
    ----------
    form : FrameFormat
        Geometry, code width and lanes.
    room : ReductionRoom
        Sums per pixel and their bits.
    packet_words : int
        Words of eight bytes in a packet, at most; the buffer has room for two. A power of two.
    read_clocks : int
        As that of `ReductionCore`.

    Members
    -------
    ready : In(1)
        There is a block to be read.
    done : Out(1)
        It has been read.
    block : In
        See `block_layout`; held while `ready`.
    settings, limits : In
        See `ReductionSettings`; held while `ready`.
    capture : In(32)
        Label of the capture.
    now : In(64)
        Device clock.
    group, lane : Out
        A pixel of the block.
    pixel : In
        Its sums, `read_clocks` later, as long as the same is asked for.
    idle : Out(1)
        No block is being read and no packet waits.
    o : Out(stream)
        See `MESSAGE_LAYOUT`.
    overflow : Out(1)
        A word is lost; see the proof ``camera-sum-packets``.
    """

    def __init__(
        self, form: FrameFormat, room: ReductionRoom, *, packet_words: int, read_clocks: int
    ) -> None:
        self.form, self.room, self.packet_words = form, room, packet_words
        self.read_clocks = read_clocks
        self.width_words = -(-room.sums // 8)
        self.plan = plan_blocks(form, room, packet_words)
        sums = data.StructLayout({f"sum{k}": width for k, width in enumerate(room.widths)})
        super().__init__(
            {
                "ready": In(1),
                "done": Out(1),
                "block": In(block_layout(self.plan, form.lanes)),
                "settings": In(settings_layout(room)),
                "limits": In(data.ArrayLayout(room.sum_bits, room.sums)),
                "capture": In(32),
                "now": In(64),
                "group": Out(range(self.plan.block_groups)),
                "lane": Out(range(form.lanes)),
                "pixel": In(sums),
                "idle": Out(1),
                "o": Out(stream.Signature(MESSAGE_LAYOUT)),
                "overflow": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.packer = packer = SumPacker(self.room.sum_bits)
        made, making = Signal(MESSAGE_LAYOUT), Signal()  # a word of header or trailer
        room, empty = self._buffer(m, packer, made, making)
        count = self.settings.sums

        lane, group = Signal.like(self.lane), Signal.like(self.group)
        last_lane, last_pixel, ends = Signal(), Signal(), Signal()
        wait = Signal(range(self.read_clocks + 1))  # until the sums of the pixel are there
        most = self.plan.block_groups * self.form.lanes
        saturated, bits = Signal(range(most + 1)), Signal(range(self.packet_words * WORD_BITS))
        sending = Signal()  # the block is read for the second time
        left = Signal(self.room.sums * self.room.sum_bits, reset_less=True)
        number, some = Signal(range(self.room.sums)), Signal()
        wide = Signal.like(left)  # all sums of a pixel, as wide as the widest
        value = left[: self.room.sum_bits]
        width, limit = Signal(WIDTH_BITS), Signal(self.room.sum_bits)
        last, reaches = Signal(), Signal()
        m.d.comb += [
            self.group.eq(group),
            self.lane.eq(lane),
            width.eq(self.settings.widths[number]),
            limit.eq(self.limits[number]),
            wide.eq(
                Cat(
                    Cat(self.pixel[f"sum{k}"], Const(0, self.room.sum_bits - width_bits))
                    for k, width_bits in enumerate(self.room.widths)
                )
            ),
            last.eq(number + 1 == count),
            reaches.eq(some | (value == limit)),
            last_lane.eq(lane == self.form.lanes - 1),
            last_pixel.eq(last_lane & (group == self.block.groups - 1)),
        ]
        with m.If(wait != 0):
            m.d.sync += wait.eq(wait - 1)
        word = Signal(range(HEAD_WORDS + self.width_words + PACK_CLOCKS))
        body = Signal(range(self.packet_words * WORD_BITS // 8))
        m.d.sync += body.eq(SUMS_BODY.size + (((count + 7) >> 3) << 3) + ((bits + 7) >> 3))
        header = self._header(saturated, body)

        with m.FSM() as fsm:
            with m.State("IDLE"):
                m.d.sync += [saturated.eq(0), bits.eq(0), sending.eq(0)]
                with m.If(self.ready & room):
                    m.next = "REWIND"
            with m.State("REWIND"):
                m.d.sync += [lane.eq(0), group.eq(0), wait.eq(self.read_clocks)]
                m.next = "PIXEL"
            with m.State("PIXEL"):
                m.d.sync += [left.eq(wide), number.eq(0), some.eq(0), ends.eq(last_pixel)]
                with m.If(wait == 0):  # the next one is on its way while this one is packed
                    m.d.sync += [
                        lane.eq(Mux(last_lane, 0, lane + 1)),
                        group.eq(Mux(last_pixel, 0, group + last_lane)),
                        wait.eq(self.read_clocks),
                    ]
                    m.next = "SUM"
            with m.State("SUM"):
                m.d.comb += packer.valid.eq(sending)
                m.d.sync += [
                    left.eq(left >> self.room.sum_bits),
                    number.eq(number + 1),
                    some.eq(reaches),
                ]
                with m.If(~sending):
                    m.d.sync += bits.eq(bits + width)
                with m.If(last):
                    with m.If(~sending):
                        m.d.sync += saturated.eq(saturated + reaches)
                    m.next = "PIXEL"
                    with m.If(ends):
                        m.d.sync += word.eq(0)
                        m.next = "LENGTH"
                        with m.If(sending):
                            m.next = "FLUSH"
            with m.State("LENGTH"):
                m.next = "HEADER"
            with m.State("HEADER"):
                m.d.comb += [
                    making.eq(word < HEAD_WORDS + ((count + 7) >> 3)),
                    made.data.eq(header[word]),
                    made.check.eq(word == PACKET_HEADER.size // 8 - 1),
                ]
                m.d.sync += word.eq(word + 1)
                with m.If(word == HEAD_WORDS + self.width_words - 1):
                    m.d.sync += sending.eq(1)
                    m.next = "REWIND"
            with m.State("FLUSH"):
                m.d.comb += packer.flush.eq(word == 0)
                m.d.sync += word.eq(word + 1)
                with m.If(word == PACK_CLOCKS):
                    m.next = "TRAILER"
            with m.State("TRAILER"):
                m.d.comb += [making.eq(1), made.last.eq(1), self.done.eq(1)]
                m.next = "LEAVE"
            with m.State("LEAVE"):
                m.next = "IDLE"  # where `ready` and the buffer's level tell of what comes next
        m.d.comb += [
            packer.value.eq(value),
            packer.width.eq(width),
            self.idle.eq(fsm.ongoing("IDLE") & ~self.ready & empty),
        ]
        return m

    def _header(self, saturated: Value, body: Value) -> Array:
        """Return the words before the sums."""
        block, settings, form = self.block, self.settings, self.form
        packet = {
            "type": Const(PacketType.SUMS.value),
            "length": body,
            "sequence": Const(0),
            "timestamp": self.now,
            "capture": self.capture,
            "check": Const(0),
        }
        sums = {
            "picture": block.picture,
            "first_pixel": block.first_group * form.lanes,
            "pixels": block.groups * form.lanes,
            "rows": Const(form.rows),
            "cols": Const(form.cols),
            "frames": block.window.frames,
            "missed": block.missed,
            "photons": block.window.photons,
            "saturated": saturated,
            "tables": settings.tables,
            "offsets": settings.moved,
            "periods": block.periods,
            "code_bits": Const(form.code_bits),
            "sums": settings.sums,
            "flags": block.window.flags,
            "reserved": Const(0),
        }
        widths = Cat(
            Cat(Mux(settings.sums > k, settings.widths[k], 0), Const(0, 8 - WIDTH_BITS))
            for k in range(self.room.sums)
        )
        words = [*record_words(PACKET_HEADER, packet), *record_words(SUMS_BODY, sums)]
        words += [widths[WORD_BITS * i :][:WORD_BITS] for i in range(self.width_words)]
        return Array(words)

    def _buffer(
        self, m: Module, packer: SumPacker, made: Signal, making: Signal
    ) -> tuple[Signal, Value]:
        """Hold packets until they are whole; return if one more finds room, and if none waits."""
        m.submodules.buffer = buffer = fifo.SyncFIFOBuffered(
            width=MESSAGE_LAYOUT.size, depth=2 * self.packet_words + 1
        )
        whole = Signal(range(2 * self.packet_words + 2))  # packets
        enters, leaves, room = Signal(), Signal(), Signal()
        packed = Signal(MESSAGE_LAYOUT)
        m.d.comb += [
            packed.data.eq(packer.word),
            buffer.w_data.eq(Mux(making, made, packed)),
            buffer.w_en.eq(making | packer.o_valid),
            self.overflow.eq((buffer.w_en & ~buffer.w_rdy) | (making & packer.o_valid)),
            self.o.payload.eq(buffer.r_data),
            self.o.valid.eq(buffer.r_rdy & (whole != 0)),
            buffer.r_en.eq(self.o.ready & self.o.valid),
            enters.eq(making & made.last),
            leaves.eq(self.o.valid & self.o.ready & self.o.payload.last),
        ]
        m.d.sync += [
            whole.eq(whole + enters - leaves),
            room.eq(buffer.level <= self.packet_words - LEVEL_CLOCKS),
        ]
        return room, buffer.level == 0
