# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to a few sums per pixel, whose windows of frames end one block after another.

`hueflight_protocol.reduction` defines the results bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence

from amaranth.hdl import Cat, Module, Mux, Signal, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from hueflight_protocol.errors import HueflightError

from .sum_slice import FETCH_CLOCKS, SLICE_SUMS, SumSlice, later
from .windows import FLAG_BITS, FRAME_BITS, BlockPlan, BlockWindows, block_layout

LATENCY = 6
"""Clocks from the reading of a group's sums to the end of their writing."""
LEAST_GROUPS = LATENCY + 1
"""Groups of a frame, at least, so that no group is read while its sums are still on their way."""
QUIET_CLOCKS = 12
"""Clocks without a beat after which nothing is on its way."""
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


class ReductionCore(wiring.Component):
    """Adds table entries of every code to the sums of its pixel.

    Beats are groups of `lanes` codes in readout order, after mask and gate; the core never lets
    them wait. Each block of pixels has a window of frames of its own, see `BlockWindows`. The sums
    of a window that is over are stored in a buffer, from which they are fetched.

    Sums are divided into slices, each a clock behind the one before, from which it takes what it
    needs. So no signal has to reach all block RAMs of a device at once.

    Parameters
    ----------
    pixels, lanes, code_bits : int
        Pixels of a frame, a multiple of `lanes`; codes per clock; width of a code.
    widths : sequence of int
        Bits of each sum, at most.
    entry_bits : int
        Bits of a table entry.
    block_groups : int
        Groups of a block, but for the last one.
    frame_bits : int
        Width of the number of frames of a window.

    Members
    -------
    valid, codes, kept, first_beat, last_beat : In
        A beat, which of its codes may add, and whether it is the first or the last of a frame.
    flags, periods : In
        What is said of its frame.
    first, last : In
        Range of codes that stand for a time; all others add nothing.
    limits : In
        Greatest value of each sum.
    frames_per_picture : In
        Frames of a window; 0 as 1.
    clear : In(1)
        Begin anew: give up all windows and count pictures from 0. No beat comes.
    discard : In(1)
        Give up all windows, since a frame of them ended early. No beat comes.
    lost : In(1)
        A frame came that is not added.
    finish, drained : In(1), Out(1)
        End all windows, while no frame comes, until nothing is left to be fetched.
    table_write, table_code, table_entries : In
        Write the entries of one code, those of the first sum in the lowest bits. Only while no
        frame comes.
    offset_write, offset_group, offsets : In
        Write the offsets of one group.
    ready : Out(1), done : In(1)
        A block can be fetched; it was.
    block : Out
        What is said of it, see `block_layout`.
    read_group, read_lane : In
        A pixel of the block.
    pixel : Out
        Its sums, `read_clocks` later, as long as the same is asked for.
    full : Out(1)
        No frame must come, since those of a window could not be counted.

    Attributes
    ----------
    read_clocks : int
        Clocks from `read_group` and `read_lane` to `pixel`.
    """

    def __init__(
        self,
        *,
        pixels: int,
        lanes: int,
        code_bits: int,
        widths: Sequence[int],
        entry_bits: int,
        block_groups: int,
        frame_bits: int = FRAME_BITS,
    ) -> None:
        self.lanes, self.groups, self.code_bits = lanes, groups_of(pixels, lanes), code_bits
        self.widths, self.entry_bits = tuple(widths), entry_bits
        self.plan = BlockPlan(self.groups, block_groups, frame_bits)
        self.pixel_layout = data.StructLayout(
            {f"sum{k}": width for k, width in enumerate(self.widths)}
        )
        self.entries_layout = data.ArrayLayout(entry_bits, len(self.widths))
        self.slices = [
            SumSlice(self.plan, lanes, self.widths[first:][:SLICE_SUMS], entry_bits)
            for first in range(0, len(self.widths), SLICE_SUMS)
        ]
        self.read_clocks = FETCH_CLOCKS + len(self.slices)
        self._windows = BlockWindows(self.plan, lanes, late=len(self.slices) - 1)
        super().__init__(
            {
                "valid": In(1),
                "codes": In(data.ArrayLayout(code_bits, lanes)),
                "kept": In(lanes),
                "first_beat": In(1),
                "last_beat": In(1),
                "flags": In(FLAG_BITS),
                "periods": In(32),
                "first": In(code_bits),
                "last": In(code_bits),
                "limits": In(self.pixel_layout),
                "frames_per_picture": In(frame_bits),
                "clear": In(1),
                "discard": In(1),
                "lost": In(1),
                "finish": In(1),
                "drained": Out(1),
                "table_write": In(1),
                "table_code": In(code_bits),
                "table_entries": In(self.entries_layout),
                "offset_write": In(1),
                "offset_group": In(range(self.groups)),
                "offsets": In(data.ArrayLayout(signed(OFFSET_BITS), lanes)),
                "ready": Out(1),
                "done": In(1),
                "block": Out(block_layout(self.plan, lanes)),
                "read_group": In(range(self.plan.block_groups)),
                "read_lane": In(range(lanes)),
                "pixel": Out(self.pixel_layout),
                "full": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.windows = windows = self._windows
        beat = self._sequence(m)
        span = Signal(self.code_bits + 1)  # codes that stand for a time
        m.d.sync += span.eq(self.last - self.first + 1)

        # clock 1: offsets arrive; clocks 2 and 3: places in the tables
        offsets = self._offsets(m, beat.place.group)
        steps, codes, kept = later(m, beat, 4), later(m, self.codes, 3), later(m, self.kept, 3)
        offsets2 = later(m, offsets, 1)[-1]
        indices, counted = [], Signal(self.lanes)
        for lane in range(self.lanes):
            moved, index = Signal(signed(self.code_bits + 2)), Signal(self.code_bits)
            code = codes[-1][lane]
            m.d.sync += [
                moved.eq(codes[-2][lane] + offsets2[lane]),
                index.eq(self._index(m, moved, span)),
                counted[lane].eq(
                    steps[-2].valid & kept[-1][lane] & (code >= self.first) & (code <= self.last)
                ),
            ]
            indices.append(index)

        # clock 4: entries and sums are read; clock 5: what becomes of them
        beat5, count5 = later(m, steps[-1])[-1], Signal.like(windows.count)
        entries = [self._entries(m, lane, index) for lane, index in enumerate(indices)]
        m.d.sync += count5.eq(sum(counted))
        m.d.comb += [
            windows.place.eq(steps[-1].place),
            windows.valid.eq(beat5.valid),
            windows.look.eq(beat5.look),
            windows.frame_last.eq(beat5.last),
            windows.discard.eq(beat5.discard),
            windows.count.eq(count5),
            windows.flags.eq(beat5.flags),
            windows.periods.eq(beat5.periods),
            windows.frames_per_picture.eq(self.frames_per_picture),
            windows.clear.eq(self.clear),
            windows.finish.eq(self.finish),
            windows.lost.eq(self.lost),
            windows.done.eq(self.done),
            self.drained.eq(windows.drained),
            self.ready.eq(windows.ready),
            self.full.eq(windows.full),
            self.block.eq(windows.block),
        ]

        # clock 6: sums are stored, and begin anew; clocks 7 and 8: the sums after the beat
        counted6 = later(m, counted, 2)[-1]
        entries7 = Signal(data.ArrayLayout(self.entries_layout, self.lanes), reset_less=True)
        for lane in range(self.lanes):
            entries6 = later(m, entries[lane])[-1]
            m.d.sync += entries7[lane].eq(Mux(counted6[lane], entries6, 0))
        # clock 9: they are written; an address of its own, not that of the reading some slices on
        written = Signal(data.StructLayout({"write": 1, "write_group": range(self.groups)}))
        m.d.comb += [
            written.write.eq(beat5.valid),
            written.write_group.eq(Mux(beat5.valid, beat5.place.group, 0)),
        ]
        self._slices(
            m,
            group=steps[-1].place.group,
            at=later(m, beat5.place.at)[-1],
            fresh=later(m, windows.fresh)[-1],
            store=later(m, windows.store)[-1],
            store_fresh=later(m, windows.store_fresh)[-1],
            entries=entries7,
            written=later(m, written, 4)[-1],
            fetch=later(m, Cat(self.read_group, self.read_lane))[-1],
        )
        return m

    def _slices(
        self, m: Module, *, entries: data.View, written: data.View, fetch: Signal, **steps: Signal
    ) -> None:
        """Connect the slices, each a clock behind the one before."""
        for number, part in enumerate(self.slices):
            m.submodules[f"slice{number}"] = part
            first = number * SLICE_SUMS
            m.d.comb += [
                *(getattr(part, name).eq(signal) for name, signal in steps.items()),
                part.write.eq(written.write),
                part.write_group.eq(written.write_group),
                Cat(part.fetch_at, part.fetch_lane).eq(fetch),
            ]
            for k in range(len(part.widths)):
                m.d.comb += [
                    part.limits[k].eq(self.limits[f"sum{first + k}"]),
                    self.pixel[f"sum{first + k}"].eq(part.pixel[k]),
                ]
                for lane in range(self.lanes):
                    m.d.comb += part.entries[lane][k].eq(entries[lane][first + k])
            steps = {name: later(m, signal)[-1] for name, signal in steps.items()}
            entries, written, fetch = (later(m, s)[-1] for s in (entries, written, fetch))

    def _sequence(self, m: Module) -> data.View:
        """Return the beat in this clock, or a look at sums that are wanted while none comes."""
        plan, windows = self.plan, self._windows
        beat = Signal(
            data.StructLayout(
                {
                    "valid": 1,
                    "look": 1,
                    "last": 1,
                    "discard": 1,
                    "flags": FLAG_BITS,
                    "periods": 32,
                    "place": plan.place_layout(),
                }
            )
        )
        m.d.comb += [
            beat.valid.eq(self.valid),
            beat.last.eq(self.last_beat),
            beat.discard.eq(self.discard),
            beat.flags.eq(self.flags),
            beat.periods.eq(self.periods),
        ]
        following, place = Signal(plan.place_layout()), Signal(plan.place_layout())
        with m.If(~self.first_beat):
            m.d.comb += place.eq(following)

        quiet, in_frame = Signal(range(QUIET_CLOCKS + 1)), Signal()
        m.d.sync += quiet.eq(Mux(quiet == QUIET_CLOCKS, quiet, quiet + 1))
        with m.If(self.valid):
            m.d.sync += in_frame.eq(~self.last_beat)
        with m.If(self.discard | self.clear):
            m.d.sync += in_frame.eq(0)
        with m.If(self.valid | in_frame | self.discard | self.clear):
            m.d.sync += quiet.eq(0)

        look, looked, wanted = Signal(), Signal.like(windows.taken), windows.wanted_place
        with m.If(windows.wanted & (quiet == QUIET_CLOCKS) & ~self.valid):
            m.d.comb += look.eq(looked != plan.groups_of(wanted.block))
            with m.If(look):
                m.d.comb += [
                    place.group.eq(wanted.group + looked),
                    place.block.eq(wanted.block),
                    place.at.eq(looked),
                ]
            m.d.sync += looked.eq(looked + look)
        with m.Else():
            m.d.sync += looked.eq(windows.taken)

        last = Signal()  # of its block
        m.d.comb += [
            last.eq(place.at == plan.groups_of(place.block) - 1),
            beat.look.eq(look),
            beat.place.eq(place),
            beat.place.last.eq(last),
        ]
        with m.If(self.valid):
            m.d.sync += [
                following.group.eq(place.group + 1),
                following.at.eq(Mux(last, 0, place.at + 1)),
                following.block.eq(place.block + last),
            ]
            with m.If(self.last_beat):
                m.d.sync += following.eq(0)  # never beyond the memories
        return beat

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

    def _index(self, m: Module, moved: Signal, count: Signal) -> Signal:
        """Place in the tables, which continue at the other end of the range of times."""
        result = Signal(unsigned(self.code_bits))
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
