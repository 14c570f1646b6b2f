# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to a few sums per pixel, in two banks: one gathers, the other is read out.

`hueflight_protocol.reduction` defines the results bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence

from amaranth.hdl import Cat, Module, Mux, Signal, Value, ValueLike, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory, WritePort
from amaranth.lib.wiring import In, Out

from hueflight_protocol.errors import HueflightError

LATENCY = 5
"""Clocks from a beat to the end of its write."""
LEAST_GROUPS = LATENCY + 1
"""Groups of a frame, at least, so that no group is read while its sums are still on their way."""
FRAME_BITS = 32
"""Width of the number of frames of a picture."""
PHOTON_BITS = 64
"""Width of the number of codes that were added to a picture."""
OFFSET_BITS = 8


def groups_of(pixels: int, lanes: int, /) -> int:
    """Return the groups of a frame.

    Parameters
    ----------
    pixels, lanes : int
        Pixels of a frame and of a group.

    Returns
    -------
    int
        Number of groups.

    Raises
    ------
    HueflightError
        If the last group would not be whole, or there are too few.
    """
    if pixels % lanes or pixels // lanes < LEAST_GROUPS:
        raise HueflightError(
            f"{pixels} pixels in {lanes} lanes: must be whole groups, at least {LEAST_GROUPS}"
        )
    return pixels // lanes


class SaturatingSum(wiring.Component):
    """Adds an entry to a sum, which stays at its greatest value.

    Parameters
    ----------
    width, entry_bits : int
        Bits of the sum and of the entry.

    Members
    -------
    before, entry : In
        The sum so far and what is added.
    limit : In
        Greatest value of the sum.
    after : Out
        Their sum, at most `limit`.
    """

    def __init__(self, width: int, entry_bits: int) -> None:
        self.width = width
        super().__init__(
            {
                "before": In(width),
                "entry": In(entry_bits),
                "limit": In(width),
                "after": Out(width),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        total = self.before + self.entry
        m.d.comb += self.after.eq(Mux(total > self.limit, self.limit, total))
        return m


class ReductionCore(wiring.Component):
    """Adds table entries of every code to the sums of its pixel.

    Beats are groups of `lanes` codes in readout order, after mask and gate; the core never lets
    them wait. After `frames_per_picture` frames the banks change places, if the earlier picture
    was read out; otherwise the picture goes on, with the frames that it holds counted.

    Parameters
    ----------
    pixels, lanes, code_bits : int
        Pixels of a frame, a multiple of `lanes`; codes per clock; width of a code.
    widths : sequence of int
        Bits of each sum, at most.
    entry_bits : int
        Bits of a table entry.

    Members
    -------
    valid, codes, first_beat, last_beat : In
        A beat, and whether it is the first or the last of a frame.
    first, last : In
        Range of codes that stand for a time; all others add nothing.
    limits : In
        Greatest value of each sum.
    frames_per_picture : In
        Frames after which a picture is over; 0 as 1.
    clear : In(1)
        Begin anew: give up the picture that gathers and count pictures from 0.
    discard : In(1)
        Give up the picture that gathers, since a frame of it ended early. No beat comes.
    finish : In(1)
        End the picture between two frames if it holds any, once the earlier one was read out.
    table_write, table_code, table_entries : In
        Write the entries of one code, those of the first sum in the lowest bits. Only while no
        frame comes.
    offset_write, offset_group, offsets : In
        Write the offsets of one group.
    held : Out(1)
        There is a picture that has not been read; the other one can't end.
    ready : Out(1)
        It can be read.
    picture, frames, photons : Out
        Its number, the frames that it holds and the codes that were added.
    gathered : Out
        Frames of the picture that gathers.
    swapped : Out(1)
        That picture ends in this clock.
    read_group : In, sums : Out
        A group of the picture, and its sums one clock later, lane after lane.
    done : In(1)
        The picture was read: its bank may be used again.
    writing, write_bank, read_bank : Out
        What the core does in this clock, for verification.
    """

    def __init__(
        self,
        *,
        pixels: int,
        lanes: int,
        code_bits: int,
        widths: Sequence[int],
        entry_bits: int,
    ) -> None:
        self.lanes, self.groups, self.code_bits = lanes, groups_of(pixels, lanes), code_bits
        self.widths, self.entry_bits = tuple(widths), entry_bits
        self.pixel_layout = data.StructLayout(
            {f"sum{k}": width for k, width in enumerate(self.widths)}
        )
        self.sums_layout = data.ArrayLayout(self.pixel_layout, lanes)
        self.entries_layout = data.ArrayLayout(entry_bits, len(self.widths))
        super().__init__(
            {
                "valid": In(1),
                "codes": In(data.ArrayLayout(code_bits, lanes)),
                "first_beat": In(1),
                "last_beat": In(1),
                "first": In(code_bits),
                "last": In(code_bits),
                "limits": In(self.pixel_layout),
                "frames_per_picture": In(FRAME_BITS),
                "clear": In(1),
                "discard": In(1),
                "finish": In(1),
                "table_write": In(1),
                "table_code": In(code_bits),
                "table_entries": In(self.entries_layout),
                "offset_write": In(1),
                "offset_group": In(range(self.groups)),
                "offsets": In(data.ArrayLayout(signed(OFFSET_BITS), lanes)),
                "held": Out(1),
                "ready": Out(1),
                "picture": Out(32),
                "frames": Out(FRAME_BITS),
                "photons": Out(PHOTON_BITS),
                "gathered": Out(FRAME_BITS),
                "swapped": Out(1),
                "read_group": In(range(self.groups)),
                "sums": Out(self.sums_layout),
                "done": In(1),
                "writing": Out(1),
                "write_bank": Out(1),
                "read_bank": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        group, bank, fresh = self._sequence(m)
        place = Cat(group, bank)
        span = Signal(self.code_bits + 1)  # codes that stand for a time
        m.d.sync += span.eq(self.last - self.first + 1)

        # clock 1: offsets arrive
        valid, code, at = Signal(), Signal(self.codes.shape()), Signal(len(place))
        is_fresh = Signal()
        offsets = self._offsets(m, group)
        m.d.sync += [valid.eq(self.valid), code.eq(self.codes), at.eq(place), is_fresh.eq(fresh)]

        # clock 2: places in the tables
        valid2, at2, fresh2 = Signal(), Signal(len(place)), Signal()
        m.d.sync += [valid2.eq(valid), at2.eq(at), fresh2.eq(is_fresh)]
        indices, counted = [], Signal(self.lanes)
        for lane in range(self.lanes):
            index = Signal(self.code_bits)
            m.d.sync += [
                index.eq(self._index(m, code[lane], offsets[lane], span)),
                counted[lane].eq((code[lane] >= self.first) & (code[lane] <= self.last)),
            ]
            indices.append(index)

        # clock 3: entries and sums arrive
        valid3, at3, fresh3, counted3 = Signal(), Signal(len(place)), Signal(), Signal(self.lanes)
        m.d.sync += [valid3.eq(valid2), at3.eq(at2), fresh3.eq(fresh2), counted3.eq(counted)]
        entries = [self._entries(m, lane, index) for lane, index in enumerate(indices)]
        before, write = self._banks(m, at2)

        # clock 4: what is written
        after = Signal(self.sums_layout)
        for lane in range(self.lanes):
            for k, width in enumerate(self.widths):
                m.submodules[f"sum{k}_{lane}"] = adder = SaturatingSum(width, self.entry_bits)
                m.d.comb += [
                    adder.before.eq(Mux(fresh3, 0, before[lane][f"sum{k}"])),
                    adder.entry.eq(Mux(counted3[lane], entries[lane][k], 0)),
                    adder.limit.eq(self.limits[f"sum{k}"]),
                ]
                m.d.sync += after[lane][f"sum{k}"].eq(adder.after)
        m.d.sync += [write.en.eq(valid3), write.addr.eq(at3)]
        m.d.comb += [
            write.data.eq(after),
            self.writing.eq(write.en),
            self.write_bank.eq(write.addr[-1]),
        ]
        starts = Signal()
        m.d.comb += starts.eq(self.valid & fresh & (group == 0))
        self._photons(m, starts, Mux(valid3, counted3, 0))
        return m

    def _photons(self, m: Module, starts: Signal, counted: Value) -> None:
        """Count the codes that are added, `counted` being three clocks behind the beats."""
        started, over = Signal(3), Signal(3)
        m.d.sync += [started.eq(Cat(starts, started)), over.eq(Cat(self.swapped, over))]
        so_far, total = Signal(PHOTON_BITS), Signal(PHOTON_BITS)
        m.d.comb += total.eq(Mux(started[-1], 0, so_far) + sum(counted))
        m.d.sync += so_far.eq(total)
        with m.If(over[-1]):
            m.d.sync += self.photons.eq(total)

    def _sequence(self, m: Module) -> tuple[Signal, Signal, Signal]:
        """Group, bank and whether the sums begin anew, of the beat in this clock."""
        following = Signal(range(self.groups))
        group = Signal(range(self.groups))
        bank, fresh = Signal(), Signal(init=1)
        number, drain = Signal(32), Signal(LATENCY + 1)
        count, frames, held = self.gathered, Signal(FRAME_BITS), self.held
        due = Signal()  # the next frame is the picture's last; known long before that frame ends
        ends = Signal()
        m.d.comb += [
            group.eq(Mux(self.first_beat, 0, following)),
            frames.eq(Mux(self.valid, count + 1, count)),
            ends.eq(Mux(self.valid, self.last_beat & due, self.finish & (following == 0))),
            self.swapped.eq(ends & (frames != 0) & ~held & ~self.discard & ~self.clear),
            self.read_bank.eq(~bank),
        ]
        m.d.sync += [drain.eq(drain << 1), due.eq(count + 1 >= self.frames_per_picture)]
        with m.If(drain[-1]):
            m.d.sync += self.ready.eq(1)
        with m.If(self.done & self.ready):
            m.d.sync += [self.ready.eq(0), held.eq(0)]
        with m.If(self.valid):
            m.d.sync += following.eq(Mux(group == self.groups - 1, 0, group + 1))
            with m.If(self.last_beat):
                m.d.sync += [count.eq(frames), fresh.eq(0)]
        with m.If(self.swapped):
            m.d.sync += [
                bank.eq(~bank),
                fresh.eq(1),
                held.eq(1),
                count.eq(0),
                drain.eq(1),
                self.frames.eq(frames),
                self.picture.eq(number),
                number.eq(number + 1),
            ]
        with m.If(self.discard | self.clear):
            m.d.sync += [fresh.eq(1), count.eq(0), following.eq(0)]
        with m.If(self.clear):
            m.d.sync += number.eq(0)
        return group, bank, fresh

    def _offsets(self, m: Module, group: Signal) -> data.View:
        layout = self.offsets.shape()
        m.submodules.offset_memory = memory = Memory(shape=layout, depth=self.groups, init=[])
        write, read = memory.write_port(), memory.read_port()
        m.d.comb += [
            write.en.eq(self.offset_write),
            write.addr.eq(self.offset_group),
            write.data.eq(self.offsets),
            read.addr.eq(group),
        ]
        return read.data

    def _index(self, m: Module, code: ValueLike, offset: ValueLike, count: Signal) -> Signal:
        """Place in the tables, which continue at the other end of the range of times."""
        moved = Signal(signed(self.code_bits + 2))
        result = Signal(unsigned(self.code_bits))
        m.d.comb += moved.eq(code + offset)
        with m.If(moved > self.last):
            m.d.comb += result.eq(moved - count)
        with m.Elif(moved < self.first):
            m.d.comb += result.eq(moved + count)
        with m.Else():
            m.d.comb += result.eq(moved)
        return result

    def _entries(self, m: Module, lane: int, index: Signal) -> data.View:
        memory = Memory(shape=self.entries_layout, depth=1 << self.code_bits, init=[])
        m.submodules[f"table{lane}"] = memory
        write, read = memory.write_port(), memory.read_port()
        m.d.comb += [
            write.en.eq(self.table_write),
            write.addr.eq(self.table_code),
            write.data.eq(self.table_entries),
            read.addr.eq(index),
        ]
        return read.data

    def _banks(self, m: Module, at: Signal) -> tuple[data.View, WritePort]:
        """Sums of a place one clock later, and the port through which they are written."""
        depth = 1 << len(at)
        m.submodules.sums_memory = memory = Memory(shape=self.sums_layout, depth=depth, init=[])
        write, read, out = memory.write_port(), memory.read_port(), memory.read_port()
        m.d.comb += [
            read.addr.eq(at),
            out.addr.eq(Cat(self.read_group, self.read_bank)),
            self.sums.eq(out.data),
        ]
        return read.data, write
