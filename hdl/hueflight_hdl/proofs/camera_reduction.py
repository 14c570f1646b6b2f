# SPDX-License-Identifier: Apache-2.0
"""Sums never wrap, no block mixes two windows of frames, and no word of a packet is lost."""

from __future__ import annotations

from amaranth.hdl import Array, Assert, Assume, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In

from hueflight_protocol.reduction_registers import ReductionRoom

from ..camera.frame_format import FrameFormat
from ..camera.reduction.core import LEAST_GROUPS, ReductionCore
from ..camera.reduction.picture_writer import PictureWriter
from ..camera.reduction.settings import ReductionSettings, settings_layout
from ..camera.reduction.sum_slice import SaturatingSum
from ..camera.reduction.windows import BlockPlan, BlockWindows
from .harness import FreeHarness

WIDTH, ENTRY_BITS = 19, 8


class SumHarness(FreeHarness):
    """One adder with free inputs."""

    def __init__(self) -> None:
        self.adder = SaturatingSum(WIDTH, ENTRY_BITS)
        super().__init__(self.adder)

    def state(self, m: Module) -> None:
        """The sum is exact or the greatest value, and never less than before."""
        adder, begun = self.adder, Signal()
        before, entry = Signal.like(adder.before), Signal.like(adder.entry)
        m.d.sync += [begun.eq(1), before.eq(adder.before), entry.eq(adder.entry)]
        exact = adder.after == before + entry
        greatest = (adder.after == adder.limit) & (before + entry >= adder.limit)
        never_less = (adder.after >= before) | (before > adder.limit)
        with m.If(begun):
            m.d.comb += [
                Assert(exact | greatest),
                Assert(adder.after <= adder.limit),
                Assert(never_less),
            ]


class WindowsHarness(FreeHarness):
    """Two blocks of three groups, with frames that come and end early at any time, and any reader.

    A number for each group stands for its sums. All codes count, so that it is the number of frames
    of the group's window.
    """

    def __init__(self) -> None:
        self.windows = BlockWindows(BlockPlan(3, 2, frame_bits=4), 1)
        super().__init__(self.windows)

    def state(self, m: Module) -> None:
        """What can be fetched holds the frames that it says, and no other."""
        windows, here = self.windows, Signal(self.windows.plan.place_layout())
        m.d.sync += here.eq(windows.place)
        self._beats(m, here)
        sums, stored = (Array(Signal(4, name=f"{name}{n}") for n in range(3)) for name in "sb")
        with m.If(windows.valid):
            m.d.sync += sums[here.group].eq(Mux(windows.fresh, 0, sums[here.group]) + 1)
        with m.If(windows.store):
            m.d.sync += stored[here.at].eq(Mux(windows.store_fresh, 0, sums[here.group]))

        block, held, about = windows.block, Signal(), Signal.like(windows.block)
        frames = block.window.frames
        m.d.sync += [held.eq(windows.ready & ~windows.done), about.eq(block)]
        with m.If(windows.ready):
            m.d.comb += [
                Assert(stored[0] == frames),
                Assert((block.groups == 1) | (stored[1] == frames)),
                Assert(block.window.photons == Mux(block.groups == 1, frames, 2 * frames)),
            ]
        with m.If(held):
            m.d.comb += [Assert(windows.ready), Assert(block == about)]

        # no frame of a block is told twice
        came, told = Signal(8), Signal(8)
        first = windows.ready & (block.first_group == 0)
        m.d.sync += came.eq(
            came + windows.lost + (windows.discard | (windows.valid & here.group[1]))
        )
        with m.If(first):
            m.d.comb += Assert(told + frames + block.missed <= came)
            with m.If(windows.done):
                m.d.sync += told.eq(told + frames + block.missed)

    def _beats(self, m: Module, here: data.View) -> None:
        """Assume beats and looks in the order in which the core gives them."""
        windows, group, looked = self.windows, Signal(range(3)), Signal(2)
        m.d.comb += [
            Assume(here.group != 3),
            Assume(here.block == here.group[1]),
            Assume(here.at == here.group[0]),
            Assume(here.last == (here.group != 0)),
            Assume(~windows.clear & (windows.count == 1)),
            Assume(~windows.valid | (here.group == group)),
            Assume(windows.frame_last == (group == 2)),
            Assume(~(windows.valid & (group == 0) & windows.full)),
            Assume(~windows.discard | (~windows.valid & (group != 0))),
            Assume(~windows.finish | (~windows.valid & (group == 0))),
        ]
        with m.If(windows.valid):
            m.d.sync += group.eq(Mux(group == 2, 0, group + 1))
        with m.If(windows.discard):
            m.d.sync += group.eq(0)
        m.d.sync += looked.eq(windows.taken)
        with m.If(windows.look):
            m.d.comb += [
                Assume(windows.wanted & ~windows.valid & (group == 0)),
                Assume(here.block == windows.wanted_place.block),
                Assume(here.at == looked),
            ]
            m.d.sync += looked.eq(looked + 1)


class WatchedCore(ReductionCore):
    """The smallest core, which says what its memory of sums does."""

    def __init__(self) -> None:
        super().__init__(
            pixels=LEAST_GROUPS, lanes=1, code_bits=1, widths=(1,), entry_bits=1, block_groups=3,
            frame_bits=4,
        )  # fmt: skip
        self.collided = Signal()  # what was read a clock ago was written as well
        self.heeded = Signal()  # what was read a clock ago matters

    def elaborate(self, platform: object) -> Module:
        m = super().elaborate(platform)
        windows, part, same = self._windows, self.slices[0], Signal()
        m.d.sync += same.eq(part.write & (part.write_group == part.group))
        m.d.comb += [
            self.collided.eq(same & (windows.valid | windows.look)),
            self.heeded.eq(~windows.fresh | (windows.store & ~windows.store_fresh)),
        ]
        return m


class SumCollisionHarness(FreeHarness):
    """The smallest core with any frames, which may end early, and any settings and reader."""

    def __init__(self) -> None:
        self.core = WatchedCore()
        super().__init__(self.core)

    def state(self, m: Module) -> None:
        """What is read while it is written is not needed, since the sums begin anew."""
        core, beat = self.core, Signal(range(LEAST_GROUPS))
        m.d.comb += [
            Assume(~core.clear & (core.periods == 0) & (core.flags == 0)),
            Assume(core.first_beat == (beat == 0)),
            Assume(core.last_beat == (beat == LEAST_GROUPS - 1)),
            Assume(~core.discard | (~core.valid & (beat != 0))),
            Assume(~core.finish | (~core.valid & (beat == 0))),
            Assert(~(core.collided & core.heeded)),
        ]
        with m.If(core.valid):
            m.d.sync += beat.eq(Mux(core.last_beat, 0, beat + 1))
        with m.If(core.discard):
            m.d.sync += beat.eq(0)


class DrainHarness(FreeHarness):
    """The smallest core, which has to end any capture with any settings, read at once."""

    SETTLE, CLOCKS = 6, 50

    def __init__(self) -> None:
        self.core = ReductionCore(
            pixels=LEAST_GROUPS, lanes=1, code_bits=1, widths=(1,), entry_bits=1, block_groups=4,
            frame_bits=3,
        )  # fmt: skip
        super().__init__(self.core)

    def state(self, m: Module) -> None:
        """Some clocks after the end of a capture, nothing is left to be fetched."""
        core, beat = self.core, Signal(range(LEAST_GROUPS))
        ending, clocks = Signal(), Signal(range(self.CLOCKS + 1))
        frames = Signal.like(core.frames_per_picture)
        m.d.sync += [ending.eq(core.finish), frames.eq(core.frames_per_picture)]
        quiet, settled = Signal(), Signal(range(self.SETTLE + 1))
        m.d.sync += settled.eq(Mux(quiet, settled + (settled != self.SETTLE), 0))
        m.d.comb += [
            quiet.eq(~(core.valid | core.discard | core.lost | core.clear)),
            Assume((core.periods == 0) & (core.flags == 0)),
            Assume(core.first_beat == (beat == 0)),
            Assume(core.last_beat == (beat == LEAST_GROUPS - 1)),
            Assume(~core.discard | (~core.valid & (beat != 0))),
            Assume(~core.clear | (~core.valid & (beat == 0))),
            Assume(~(core.full & core.valid & (beat == 0))),
            Assume((core.frames_per_picture == frames) | core.clear),
            Assume(~core.finish | (quiet & (beat == 0) & (settled == self.SETTLE))),
            Assume(core.finish | ~ending),
            Assume(core.done == core.ready),
            Assert((clocks != self.CLOCKS) | core.drained),
        ]
        with m.If(core.valid):
            m.d.sync += beat.eq(Mux(core.last_beat, 0, beat + 1))
        with m.If(core.discard):
            m.d.sync += beat.eq(0)
        with m.If(core.finish & (clocks != self.CLOCKS)):
            m.d.sync += clocks.eq(clocks + 1)


class SettledWriter(wiring.Component):
    """A writer with settings as registers ask for them, and a link that takes every word."""

    def __init__(self) -> None:
        room = ReductionRoom(sums=2, entry_bits=1, sum_bits=2, group=4)
        form = FrameFormat(rows=1, cols=4, code_bits=2, lanes=1)
        self.settings = ReductionSettings(room, form.code_bits)
        self.writer = PictureWriter(form, room, packet_words=16, read_clocks=1)
        super().__init__({"began": In(1), "asked": In(settings_layout(room)), "ready": In(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.settings = settings = self.settings
        m.submodules.writer = writer = self.writer
        m.d.comb += [
            settings.began.eq(self.began),
            settings.asked.eq(self.asked),
            writer.settings.eq(settings.held),
            writer.limits.eq(settings.limits),
            writer.ready.eq(self.ready),
            writer.block.groups.eq(1),
            writer.o.ready.eq(1),
        ]
        return m


class WriterProgressHarness(FreeHarness):
    """A writer that has to make a packet of a block, with any contents of the registers."""

    CLOCKS = 50

    def __init__(self) -> None:
        self.settled = SettledWriter()
        super().__init__(self.settled)

    def state(self, m: Module) -> None:
        """A block that waits has been read after some clocks, if sums are sent at all."""
        settled, clocks = self.settled, Signal(range(self.CLOCKS + 1))
        writer, waited = settled.writer, Signal()
        m.d.sync += [clocks.eq(0), waited.eq(settled.ready & ~writer.done)]
        with m.If(settled.ready & ~writer.done):
            m.d.sync += clocks.eq(clocks + 1)
        m.d.comb += [
            Assume(~settled.ready | (settled.settings.sums & ~settled.began)),
            Assume(settled.ready | ~waited),
            Assert(clocks != self.CLOCKS),
        ]


class WriterHarness(FreeHarness):
    """A writer whose packets hold a pixel each, with any sums and blocks; its link stands."""

    def __init__(self) -> None:
        self.writer = PictureWriter(
            FrameFormat(rows=1, cols=4, code_bits=2, lanes=1),
            ReductionRoom(sums=1, entry_bits=1, sum_bits=1, group=4),
            packet_words=16,
            read_clocks=1,
        )
        super().__init__(self.writer)

    def state(self, m: Module) -> None:
        """No word finds the buffer full, and no two words come at once."""
        settings, block = self.writer.settings, self.writer.block
        m.d.comb += [
            Assume(block.groups == 1),
            self.writer.o.ready.eq(0),
            settings.sums.eq(1),
            settings.widths[0].eq(1),
            Assert(~self.writer.overflow),
        ]
