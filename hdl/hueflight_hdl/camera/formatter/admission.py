# SPDX-License-Identifier: Apache-2.0
"""Admission of beats: a chunk begins only when a bank is free for it."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..frame_format import FrameFormat


class FrameAdmission(wiring.Component):
    """Counts the beats of frames and holds them back while no bank is free.

    It is the only block of the write side that can refuse a beat; the blocks behind it never wait.

    Members
    -------
    i : In(stream)
        Codes in readout order, `lanes` at a time; row follows on row without a gap.
    abort : In(1)
        Give up the frame in progress. No beat is taken in this clock.
    header_free : In(1)
        There is room for the header of a new frame.
    freed : In(1)
        A bank has been read.
    o : Out(stream)
        Beats, see `FrameFormat.beat_layout`; cannot wait.
    ends : Out(1)
        The next beat is its frame's last.
    begins : Out(1)
        A frame's first beat is taken.
    in_frame : Out(1)
        Some but not all of a frame's beats have been taken.
    hold : Out(1)
        As `in_frame`, one clock before.
    banks_free : Out
        Number of free banks.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        super().__init__(
            {
                "i": In(stream.Signature(form.codes_layout(form.lanes))),
                "abort": In(1),
                "header_free": In(1),
                "freed": In(1),
                "o": Out(stream.Signature(form.beat_layout, always_ready=True)),
                "ends": Out(1),
                "begins": Out(1),
                "in_frame": Out(1),
                "hold": Out(1),
                "banks_free": Out(range(form.banks + 1), init=form.banks),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form = self.form
        inner, last = form.chunk(last=False), form.chunk(last=True)
        beat = Signal(range(inner.beats))
        chunk = Signal(range(form.chunks))
        starts = Signal(init=1)  # the next beat begins a chunk
        in_last = Signal(init=form.chunks == 1)  # the next beat belongs to the last chunk
        taken, aborts = Signal(), Signal()
        # the next beat ends a chunk: known before it comes, as many signals depend on it
        lone = form.chunk(last=form.chunks == 1).beats == 1
        chunk_end, frame_end = Signal(init=lone), Signal()
        next_last = Signal()  # the chunk that follows is the last
        payload = self.o.payload
        m.d.comb += [
            self.i.ready.eq(
                ~self.abort
                & (~starts | (self.banks_free != 0))
                & (self.in_frame | self.header_free)
            ),
            taken.eq(self.i.valid & self.i.ready),
            aborts.eq(self.abort & self.in_frame),
            self.begins.eq(taken & ~self.in_frame),
            self.hold.eq(Mux(taken, ~frame_end, self.in_frame & ~self.abort)),
            self.o.valid.eq(taken | aborts),
            payload.codes.eq(self.i.payload),
            payload.first.eq(~self.in_frame),
            next_last.eq(chunk == form.chunks - 2),
            frame_end.eq(chunk_end & in_last),
            self.ends.eq(frame_end),
            payload.chunk_end.eq(chunk_end),
            payload.frame_end.eq(frame_end),
            payload.abort.eq(aborts),
        ]
        m.d.sync += [
            self.in_frame.eq(self.hold),
            # an aborted chunk that was begun gives its bank back
            self.banks_free.eq(
                self.banks_free + self.freed + (aborts & ~starts) - (taken & starts)
            ),
        ]
        with m.If(taken):
            m.d.sync += [
                beat.eq(beat + 1),
                starts.eq(chunk_end),
                chunk_end.eq(beat + 2 == Mux(in_last, last.beats, inner.beats)),
            ]
            with m.If(chunk_end):
                m.d.sync += [
                    beat.eq(0),
                    chunk.eq(chunk + 1),
                    in_last.eq(next_last),
                    chunk_end.eq(Mux(next_last, last.beats == 1, inner.beats == 1)),
                ]
        with m.If(aborts | (taken & frame_end)):
            m.d.sync += [
                beat.eq(0),
                chunk.eq(0),
                starts.eq(1),
                in_last.eq(form.chunks == 1),
                chunk_end.eq(lone),
            ]
        return m
