# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to a few sums per pixel, in two banks: one gathers, the other is read out.

`hueflight_protocol.reduction` defines the results bit for bit. The core is not part of a board's
design yet.
"""

from __future__ import annotations

from collections.abc import Sequence

from amaranth.hdl import Cat, Module, Mux, Signal, ValueLike, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory, WritePort
from amaranth.lib.wiring import In, Out

from hueflight_protocol.errors import HueflightError

LATENCY = 5
"""Clocks from a beat to the end of its write."""
LEAST_GROUPS = LATENCY + 1
"""Groups of a frame, at least, so that no group is read while its sums are still on their way."""
FRAME_BITS = 16
"""Width of the number of frames of a picture."""
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
    after : Out
        Their sum, at most 2**width - 1.
    """

    def __init__(self, width: int, entry_bits: int) -> None:
        self.width = width
        super().__init__({"before": In(width), "entry": In(entry_bits), "after": Out(width)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        total = self.before + self.entry
        limit = (1 << self.width) - 1
        m.d.comb += self.after.eq(Mux(total > limit, limit, total))
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
        Bits of each sum.
    entry_bits : int
        Bits of a table entry.
    first, last : int
        Range of codes that stand for a time; all others add nothing.

    Members
    -------
    valid, codes, first_beat, last_beat : In
        A beat, and whether it is the first or the last of a frame.
    frames_per_picture : In
        Frames after which a picture is over.
    table_write, table_code, table_entries : In
        Write the entries of one code, those of the first sum in the lowest bits. Only while no
        frame comes.
    offset_write, offset_group, offsets : In
        Write the offsets of one group.
    ready : Out(1)
        A picture can be read.
    picture, frames : Out
        Its number, and the frames that it holds.
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
        first: int,
        last: int,
    ) -> None:
        self.lanes, self.groups, self.code_bits = lanes, groups_of(pixels, lanes), code_bits
        self.widths, self.entry_bits = tuple(widths), entry_bits
        self.first, self.last = first, last
        self.sums_layout = data.ArrayLayout(
            data.StructLayout({f"sum{k}": width for k, width in enumerate(self.widths)}), lanes
        )
        self.entries_layout = data.ArrayLayout(entry_bits, len(self.widths))
        super().__init__(
            {
                "valid": In(1),
                "codes": In(data.ArrayLayout(code_bits, lanes)),
                "first_beat": In(1),
                "last_beat": In(1),
                "frames_per_picture": In(FRAME_BITS),
                "table_write": In(1),
                "table_code": In(code_bits),
                "table_entries": In(self.entries_layout),
                "offset_write": In(1),
                "offset_group": In(range(self.groups)),
                "offsets": In(data.ArrayLayout(signed(OFFSET_BITS), lanes)),
                "ready": Out(1),
                "picture": Out(32),
                "frames": Out(FRAME_BITS),
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
                index.eq(self._index(m, code[lane], offsets[lane])),
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
                ]
                m.d.sync += after[lane][f"sum{k}"].eq(adder.after)
        m.d.sync += [write.en.eq(valid3), write.addr.eq(at3)]
        m.d.comb += [
            write.data.eq(after),
            self.writing.eq(write.en),
            self.write_bank.eq(write.addr[-1]),
        ]
        return m

    def _sequence(self, m: Module) -> tuple[Signal, Signal, Signal]:
        """Group, bank and whether the sums begin anew, of the beat in this clock."""
        following = Signal(range(self.groups))
        group = Signal(range(self.groups))
        bank, fresh = Signal(), Signal(init=1)
        held = Signal()  # the other bank holds a picture that was not read
        count, number = Signal(FRAME_BITS), Signal(32)
        drain = Signal(LATENCY + 1)
        m.d.comb += group.eq(Mux(self.first_beat, 0, following))
        m.d.comb += self.read_bank.eq(~bank)
        m.d.sync += drain.eq(drain << 1)
        with m.If(drain[-1]):
            m.d.sync += self.ready.eq(1)
        with m.If(self.done & self.ready):
            m.d.sync += [self.ready.eq(0), held.eq(0)]
        with m.If(self.valid):
            m.d.sync += following.eq(Mux(group == self.groups - 1, 0, group + 1))
        frames = Signal(FRAME_BITS)
        m.d.comb += frames.eq(Mux(count.all(), count, count + 1))
        with m.If(self.valid & self.last_beat):
            m.d.sync += [count.eq(frames), fresh.eq(0)]
            with m.If((frames >= self.frames_per_picture) & ~held):
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

    def _index(self, m: Module, code: ValueLike, offset: ValueLike) -> Signal:
        """Place in the tables, which continue at the other end of the range of times."""
        count = self.last - self.first + 1
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
