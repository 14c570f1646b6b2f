# SPDX-License-Identifier: Apache-2.0
"""Sums never wrap, the two banks never mix two pictures, and no word of a packet is lost."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Signal

from hueflight_protocol.reduction_registers import ReductionRoom

from ..camera.frame_format import FrameFormat
from ..camera.reduction.core import LEAST_GROUPS, ReductionCore, SaturatingSum
from ..camera.reduction.picture_writer import PictureWriter
from .harness import FreeHarness

WIDTH, ENTRY_BITS = 19, 8


class SumHarness(FreeHarness):
    """One adder with free inputs."""

    def __init__(self) -> None:
        self.adder = SaturatingSum(WIDTH, ENTRY_BITS)
        super().__init__(self.adder)

    def state(self, m: Module) -> None:
        """The sum is exact or the greatest value, and never less than before."""
        adder = self.adder
        exact = adder.after == adder.before + adder.entry
        greatest = (adder.after == adder.limit) & (adder.before + adder.entry >= adder.limit)
        never_less = (adder.after >= adder.before) | (adder.before > adder.limit)
        m.d.comb += [
            Assert(exact | greatest),
            Assert(adder.after <= adder.limit),
            Assert(never_less),
        ]


class BanksHarness(FreeHarness):
    """The smallest core with free inputs: any beats, marks, settings and readers."""

    def __init__(self) -> None:
        self.core = ReductionCore(
            pixels=LEAST_GROUPS,
            lanes=1,
            code_bits=2,
            widths=(2,),
            entry_bits=1,
        )
        super().__init__(self.core)

    def state(self, m: Module) -> None:
        """A picture that can be read does not change until it is given back."""
        core = self.core
        written = core.writing & (core.write_bank == core.read_bank)
        m.d.comb += Assert(~(core.ready & written))
        for value in (core.read_bank, core.picture, core.frames, core.photons):
            before, kept = Signal.like(value), Signal()
            m.d.sync += [before.eq(value), kept.eq(core.ready & ~core.done)]
            with m.If(kept):
                m.d.comb += [Assert(value == before), Assert(core.ready)]


class WriterHarness(FreeHarness):
    """A writer whose packets hold a pixel each, with any sums, pictures and stalls of the link."""

    def __init__(self) -> None:
        self.writer = PictureWriter(
            FrameFormat(rows=1, cols=4, code_bits=2, lanes=1),
            ReductionRoom(sums=1, entry_bits=1, sum_bits=1, group=4),
            packet_words=16,
        )
        self.writer.part_pixels = 1
        super().__init__(self.writer)

    def state(self, m: Module) -> None:
        """No word finds the buffer full, and no two words come at once."""
        settings = self.writer.settings
        m.d.comb += [
            settings.sums.eq(1),
            settings.widths[0].eq(1),
            Assert(~self.writer.overflow),
        ]
