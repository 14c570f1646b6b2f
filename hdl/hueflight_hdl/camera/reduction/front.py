# SPDX-License-Identifier: Apache-2.0
"""The frames that a reduction adds: admitted by themselves, whatever becomes of their codes."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out
from amaranth.utils import ceil_log2

from hueflight_protocol.wire import FrameFlags

from ..exposure.frame_guard import FrameGuard
from ..formatter.pixel_filter import FILTER_LAYOUT, MASK_WORD, PixelFilter
from ..frame_format import FrameFormat
from ..sensor.port import sensor_beat_layout

ABOUT_FRAME_LAYOUT = data.StructLayout({"flags": 16, "periods": 32})
"""What a packet of sums says of its frames."""


class ReductionFront(wiring.Component):
    """Checks and filters the frames of a sensor as the formatter's guard and filter do.

    It never makes a frame wait, so that a stalled link costs no frame of the sums.

    Parameters
    ----------
    form : FrameFormat
        Geometry and lanes.
    patience : int
        Number of clocks without a beat after which a readout counts as a fault.

    Members
    -------
    read, give_up, sensor, admit : In
        As those of `FrameGuard`.
    busy, dropped, aborted, over, fault : Out(1)
        As those of `FrameGuard`.
    begins : Out(1)
        A frame's first beat is taken.
    filters : In
        See `FILTER_LAYOUT`; held through a frame.
    mask_address, mask_data : Out, In
        The pixel mask's memory, see `PixelFilter`.
    about : In
        See `ABOUT_FRAME_LAYOUT`; taken over with a frame's first beat. Flags of the filters are
        added.
    valid, codes, kept, first_beat, last_beat : Out
        A beat after the filters, and which of its codes these have left.
    about_beat : Out
        What is said of its frame.
    discard : Out(1)
        The frame before this clock ended early.
    """

    def __init__(self, form: FrameFormat, *, patience: int) -> None:
        self.form, self.patience = form, patience
        super().__init__(
            {
                "read": In(1),
                "give_up": In(1),
                "sensor": In(stream.Signature(sensor_beat_layout(form), always_ready=True)),
                "admit": In(1),
                "busy": Out(1),
                "dropped": Out(1),
                "aborted": Out(1),
                "over": Out(1),
                "fault": Out(1),
                "begins": Out(1),
                "filters": In(FILTER_LAYOUT),
                "mask_address": Out(ceil_log2(-(-form.pixels // MASK_WORD))),
                "mask_data": In(MASK_WORD),
                "about": In(ABOUT_FRAME_LAYOUT),
                "valid": Out(1),
                "codes": Out(form.codes_layout(form.lanes)),
                "kept": Out(form.lanes),
                "first_beat": Out(1),
                "last_beat": Out(1),
                "about_beat": Out(ABOUT_FRAME_LAYOUT),
                "discard": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.guard = guard = FrameGuard(self.form, patience=self.patience)
        m.submodules.filter = pixel_filter = PixelFilter(self.form)
        m.d.comb += [
            guard.read.eq(self.read),
            guard.give_up.eq(self.give_up),
            guard.sensor.valid.eq(self.sensor.valid),
            guard.sensor.payload.eq(self.sensor.payload),
            guard.admit.eq(self.admit),
            self.busy.eq(guard.busy),
            self.dropped.eq(guard.dropped),
            self.aborted.eq(guard.aborted),
            self.over.eq(guard.over),
            self.fault.eq(guard.fault),
        ]

        beat = Signal(range(self.form.beats))
        in_frame, hold, taken, aborts = Signal(), Signal(), Signal(), Signal()
        entering = pixel_filter.i.payload
        m.d.comb += [
            guard.beats.ready.eq(~guard.abort),
            guard.ends.eq(beat == self.form.beats - 1),
            taken.eq(guard.beats.valid & guard.beats.ready),
            aborts.eq(guard.abort & in_frame),
            hold.eq(Mux(taken, ~guard.ends, in_frame & ~guard.abort)),
            self.begins.eq(taken & ~in_frame),
            pixel_filter.hold.eq(hold),
            pixel_filter.settings.eq(self.filters),
            pixel_filter.i.valid.eq(taken | aborts),
            entering.codes.eq(guard.beats.payload),
            entering.first.eq(~in_frame),
            entering.frame_end.eq(guard.ends & ~aborts),
            entering.abort.eq(aborts),
            self.mask_address.eq(pixel_filter.mask_address),
            pixel_filter.mask_data.eq(self.mask_data),
        ]
        m.d.sync += in_frame.eq(hold)
        with m.If(taken):
            m.d.sync += beat.eq(beat + 1)
        with m.If(~hold):
            m.d.sync += beat.eq(0)
        self._say(m, pixel_filter)
        leaving = pixel_filter.o.payload
        m.d.comb += [
            self.valid.eq(pixel_filter.o.valid & ~leaving.abort),
            self.discard.eq(pixel_filter.o.valid & leaving.abort),
            self.codes.eq(leaving.codes),
            self.kept.eq(pixel_filter.kept),
            self.first_beat.eq(leaving.first),
            self.last_beat.eq(leaving.frame_end),
        ]
        return m

    def _say(self, m: Module, pixel_filter: PixelFilter) -> None:
        """Take what is said of a frame along with its beats."""
        flags = (FrameFlags.MASKED, FrameFlags.ROI, FrameFlags.GATED)
        done = sum(
            (Mux(pixel_filter.on[i], flag.value, 0) for i, flag in enumerate(flags)),
            start=Signal(16),
        )
        held, about = Signal(ABOUT_FRAME_LAYOUT), Signal(ABOUT_FRAME_LAYOUT)
        m.d.comb += about.eq(held)
        with m.If(self.begins):
            m.d.comb += [
                about.flags.eq(self.about.flags | done),
                about.periods.eq(self.about.periods),
            ]
        m.d.sync += held.eq(about)
        for _ in range(pixel_filter.latency):
            later = Signal(ABOUT_FRAME_LAYOUT)
            m.d.sync += later.eq(about)
            about = later
        m.d.comb += self.about_beat.eq(about)
