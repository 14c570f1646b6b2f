# SPDX-License-Identifier: Apache-2.0
"""Assembles beats into groups of eight codes."""

from __future__ import annotations

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..frame_format import GROUP, FrameFormat


class GroupAssembler(wiring.Component):
    """Collects the codes of several beats in a group; the last group of a chunk is padded with 0.

    Members
    -------
    i : In(stream)
        Beats, see `FrameFormat.beat_layout`; never waits.
    o : Out(stream)
        Groups, see `FrameFormat.group_layout`; cannot wait.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        super().__init__(
            {
                "i": In(stream.Signature(form.beat_layout, always_ready=True)),
                "o": Out(stream.Signature(form.group_layout, always_ready=True)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        lanes = self.form.lanes
        beat, group = self.i.payload, self.o.payload
        slot = Signal(range(GROUP // lanes))
        complete = Signal()
        m.d.comb += complete.eq((slot == GROUP // lanes - 1) | beat.chunk_end | beat.abort)
        m.d.sync += self.o.valid.eq(self.i.valid & complete)

        with m.If(self.i.valid):
            m.d.sync += [
                slot.eq(slot + 1),
                group.chunk_end.eq(beat.chunk_end),
                group.frame_end.eq(beat.frame_end),
                group.abort.eq(beat.abort),
            ]
            with m.If(complete):
                m.d.sync += slot.eq(0)
            with m.If(slot == 0):
                m.d.sync += (group.codes[place].eq(0) for place in range(GROUP))
            for first in range(0, GROUP, lanes):
                with m.If(slot == first // lanes):
                    for lane in range(lanes):
                        code = beat.codes[lane]
                        m.d.sync += group.codes[first + lane].eq(code)
                        if lane >= self.form.last_lanes:
                            with m.If(beat.frame_end):
                                m.d.sync += group.codes[first + lane].eq(0)
        return m
