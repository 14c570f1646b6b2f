# SPDX-License-Identifier: Apache-2.0
"""The reduction of a camera: frames in, packets of sums out."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped
from amaranth.utils import ceil_log2

from hueflight_protocol.reduction_registers import ReductionRoom

from ..formatter.piece_reader import MESSAGE_LAYOUT
from ..formatter.pixel_filter import FILTER_LAYOUT, MASK_WORD
from ..frame_format import FormatError, FrameFormat
from ..sensor.port import sensor_beat_layout
from .core import OFFSET_BITS, ReductionCore, groups_of
from .front import ABOUT_FRAME_LAYOUT, ReductionFront
from .picture_writer import PictureWriter, plan_blocks
from .settings import ReductionSettings, settings_layout

PACKET_WORDS = 256
"""Words of eight bytes in a packet of sums, at most."""
LEAST_GROUP = 4
"""Pixels whose offsets fill a register."""
SETTLE_CLOCKS = 16
"""Clocks after which all of a capture's frames have been added."""


def offset_group(lanes: int, /) -> int:
    """Return how many pixels have their offsets stored together.

    Parameters
    ----------
    lanes : int
        Codes per clock.

    Returns
    -------
    int
        Number of pixels, as `ReductionRoom.group` must have it.
    """
    return max(lanes, LEAST_GROUP)


def check_room(form: FrameFormat, room: ReductionRoom, /, *, packet_words: int) -> None:
    """Check that a reduction fits a frame format.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    room : ReductionRoom
        What there is to be room for.
    packet_words : int
        Words of eight bytes in a packet of sums, at most.

    Raises
    ------
    FormatError
        If the offsets of another number of pixels are stored together than `offset_group` says, or
        a group of pixels is cut by the end of a frame.
    HueflightError
        If a packet has no room for a group of pixels, or the frame is too small.
    """
    group = offset_group(form.lanes)
    if room.group != group:
        raise FormatError(f"group = {room.group}: must be {group} for {form.lanes} lanes")
    if form.pixels % group:
        raise FormatError(f"{form.pixels} pixels: must be a multiple of {group} for a reduction")
    groups_of(form.pixels, form.lanes)
    plan_blocks(form, room, packet_words)


class Reducer(wiring.Component):
    """Adds up the frames of a sensor and sends pictures, as the settings say.

    A frame that ends early spoils the windows that it belongs to: all their frames count as missed.
    When a capture ends, what has been gathered is sent, and so is the rest of the last picture.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    room : ReductionRoom
        Sums per pixel and their bits, bits of table entries.
    patience : int
        As for `FrameGuard`.
    packet_words : int
        As for `PictureWriter`.

    Members
    -------
    began, ended : In(1)
        A capture begins or has ended.
    asked : In
        Settings, see `settings_layout`; taken over when a capture begins.
    codes, sums : Out(1)
        What is sent in this capture. If no sums are, nothing is read.
    read, give_up, sensor : In
        As those of `FrameGuard`.
    busy, begins, over, dropped, aborted, fault : Out(1)
        As those of `ReductionFront`.
    added : Out(1)
        A frame has been added.
    filters, mask_address, mask_data : In, Out, In
        As those of `PixelFilter`.
    about : In
        See `ABOUT_FRAME_LAYOUT`.
    capture : In(32), now : In(64)
        Label of the capture, device clock.
    store, store_code, entries : In
        Write the entries of one code into the tables; of no effect beyond the last code.
    move, move_group, offsets : In
        Write the offsets of one group of pixels; of no effect beyond the last group. Held for
        `offset_group` clocks.
    idle : Out(1)
        Nothing of a capture that has ended is still to be sent.
    o : Out(stream)
        Packets, see `MESSAGE_LAYOUT`.
    """

    def __init__(
        self, form: FrameFormat, room: ReductionRoom, *, patience: int, packet_words: int
    ) -> None:
        check_room(form, room, packet_words=packet_words)
        self.form, self.room = form, room
        self._settings = ReductionSettings(room, form.code_bits)
        self._front = ReductionFront(form, patience=patience)
        self._core = ReductionCore(
            pixels=form.pixels,
            lanes=form.lanes,
            code_bits=form.code_bits,
            widths=room.widths,
            entry_bits=room.entry_bits,
            block_groups=plan_blocks(form, room, packet_words).block_groups,
        )
        self._writer = PictureWriter(
            form, room, packet_words=packet_words, read_clocks=self._core.read_clocks
        )
        super().__init__(
            {
                "began": In(1),
                "ended": In(1),
                "asked": In(settings_layout(room)),
                "codes": Out(1),
                "sums": Out(1),
                "read": In(1),
                "give_up": In(1),
                "sensor": In(stream.Signature(sensor_beat_layout(form), always_ready=True)),
                "busy": Out(1),
                "begins": Out(1),
                "over": Out(1),
                "dropped": Out(1),
                "aborted": Out(1),
                "fault": Out(1),
                "added": Out(1),
                "filters": In(FILTER_LAYOUT),
                "mask_address": Out(ceil_log2(-(-form.pixels // MASK_WORD))),
                "mask_data": In(MASK_WORD),
                "about": In(ABOUT_FRAME_LAYOUT),
                "capture": In(32),
                "now": In(64),
                "store": In(1),
                "store_code": In(16),
                "entries": In(data.ArrayLayout(room.entry_bits, room.sums)),
                "move": In(1),
                "move_group": In(20),
                "offsets": In(data.ArrayLayout(OFFSET_BITS, room.group)),
                "idle": Out(1),
                "o": Out(stream.Signature(MESSAGE_LAYOUT)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.settings = settings = self._settings
        m.submodules.front = self._front
        m.submodules.core = core = self._core
        m.submodules.writer = writer = self._writer
        m.d.comb += [
            settings.began.eq(self.began),
            settings.asked.eq(self.asked),
            self.codes.eq(settings.codes),
            self.sums.eq(settings.sums),
            core.first.eq(settings.held.first),
            core.last.eq(settings.held.last),
            core.frames_per_picture.eq(settings.held.frames),
            core.clear.eq(self.began),
        ]
        for k in range(self.room.sums):
            m.d.comb += core.limits[f"sum{k}"].eq(settings.limits[k])
        self._frames(m)
        self._memories(m)
        finished = self._finish(m)
        m.d.comb += [
            writer.ready.eq(core.ready),
            core.done.eq(writer.done),
            core.read_group.eq(writer.group),
            core.read_lane.eq(writer.lane),
            writer.pixel.eq(core.pixel),
            writer.block.eq(core.block),
            writer.capture.eq(self.capture),
            writer.settings.eq(settings.held),
            writer.limits.eq(settings.limits),
            writer.now.eq(self.now),
            self.idle.eq(finished & writer.idle),
        ]
        connect(m, writer.o, flipped(self.o))
        return m

    def _frames(self, m: Module) -> None:
        """Pass frames from the sensor to the core."""
        front, core = self._front, self._core
        m.d.comb += [
            front.read.eq(self.read & self._settings.sums),
            front.give_up.eq(self.give_up),
            front.sensor.valid.eq(self.sensor.valid),
            front.sensor.payload.eq(self.sensor.payload),
            front.admit.eq(~core.full),
            front.filters.eq(self.filters),
            self.mask_address.eq(front.mask_address),
            front.mask_data.eq(self.mask_data),
            front.about.eq(self.about),
            core.valid.eq(front.valid),
            core.codes.eq(front.codes),
            core.kept.eq(front.kept),
            core.first_beat.eq(front.first_beat),
            core.last_beat.eq(front.last_beat),
            core.discard.eq(front.discard),
            core.lost.eq(front.dropped),
            core.flags.eq(front.about_beat.flags),
            core.periods.eq(front.about_beat.periods),
            self.added.eq(front.valid & front.last_beat),
        ]
        for name in ("busy", "begins", "over", "dropped", "aborted", "fault"):
            m.d.comb += getattr(self, name).eq(getattr(front, name))

    def _memories(self, m: Module) -> None:
        """Store entries and offsets; the latter a group of the core at a time."""
        core, lanes = self._core, self.form.lanes
        parts = self.room.group // lanes
        left, place = Signal(range(parts + 1)), Signal(range(parts))
        first = Signal(range(core.groups))
        m.d.comb += [
            core.table_write.eq(self.store & (self.store_code >> self.form.code_bits == 0)),
            core.table_code.eq(self.store_code),
            core.table_entries.eq(self.entries),
            core.offset_write.eq(left != 0),
            core.offset_group.eq(first + place),
            core.offsets.eq(self.offsets.as_value().word_select(place, lanes * OFFSET_BITS)),
        ]
        with m.If(left != 0):
            m.d.sync += [left.eq(left - 1), place.eq(place + 1)]
        with m.If(self.move & (self.move_group < core.groups // parts)):
            m.d.sync += [left.eq(parts), place.eq(0), first.eq(self.move_group * parts)]

    def _finish(self, m: Module) -> Signal:
        """Send what has been gathered when a capture ends; return whether that is done."""
        finished, left = Signal(init=1), Signal(range(SETTLE_CLOCKS + 1))
        m.d.comb += self._core.finish.eq(~finished & (left == 0))
        with m.If(left != 0):
            m.d.sync += left.eq(left - 1)
        with m.Elif(self._core.drained):
            m.d.sync += finished.eq(1)
        with m.If(self.ended):
            m.d.sync += [finished.eq(0), left.eq(SETTLE_CLOCKS)]
        return finished
