# SPDX-License-Identifier: Apache-2.0
"""Filters that leave out codes: pixel mask, region of interest, time gate."""

from __future__ import annotations

from amaranth.hdl import C, Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out
from amaranth.utils import ceil_log2

from ..frame_format import FrameFormat

MASK_WORD = 32
"""Pixels per word of the mask memory."""

WINDOW_LAYOUT = data.StructLayout({"first": 16, "last": 16})
"""First and last one kept."""

FILTER_LAYOUT = data.StructLayout(
    {
        "mask": 1,
        "roi": 1,
        "gate": 1,
        "rows": WINDOW_LAYOUT,
        "cols": WINDOW_LAYOUT,
        "codes": WINDOW_LAYOUT,
    }
)
"""Which filters are on, and their windows."""


class PixelFilter(wiring.Component):
    """Replaces codes that a filter leaves out by 0.

    Settings are held from a frame's first beat to its last. A window whose first lies behind
    its last keeps nothing.

    Members
    -------
    i, o : stream of `FrameFormat.beat_layout`
        Never waits; three clocks from input to output.
    kept : Out
        Which codes of the beat at the output are left; one that is left may be 0 as well.
    settings : In
        See `FILTER_LAYOUT`.
    hold : In(1)
        The next beat belongs to the same frame as the present one.
    on : Out(3)
        Filters that are on for the beat at the input: mask, roi, gate from bit 0 up.
    mask_address : Out
        Word of the mask memory; read in one clock.
    mask_data : In(32)
        Pixels to leave out, in readout order.
    """

    latency = 3

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        beats = stream.Signature(form.beat_layout, always_ready=True)
        super().__init__(
            {
                "i": In(beats),
                "o": Out(beats),
                "kept": Out(form.lanes),
                "settings": In(FILTER_LAYOUT),
                "hold": In(1),
                "on": Out(3),
                "mask_address": Out(ceil_log2(-(-form.pixels // MASK_WORD))),
                "mask_data": In(MASK_WORD),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        form = self.form
        lanes = range(form.lanes)
        settings = self.settings
        on = Signal(3)
        beat = self.i.payload
        m.d.sync += on.eq(self.on)
        with m.If(~self.hold):
            m.d.sync += self.on.eq(Cat(settings.mask, settings.roi, settings.gate))

        rows = Window(m, settings.rows, form.rows, hold=self.hold)
        cols = Window(m, settings.cols, form.cols, hold=self.hold)
        codes = Window(m, settings.codes, 1 << form.code_bits, hold=self.hold)
        positions = self._positions(m)

        # 1: every comparison by itself
        in_row = [rows.keeps(m, row) for row, _ in positions]
        in_col = [cols.keeps(m, col) for _, col in positions]
        in_gate = [codes.keeps(m, beat.codes[lane]) for lane in lanes]
        masked = self._masked(m)

        # 2: two bits per lane
        keep, hidden = Signal(form.lanes), Signal(form.lanes)
        for lane in lanes:
            in_region = in_row[lane] & in_col[lane]
            out = (on[1] & ~in_region) | (on[2] & ~in_gate[lane])
            m.d.sync += [
                keep[lane].eq(~out),
                hidden[lane].eq(on[0] & masked[lane]),  # by itself: block memories are slow
            ]

        # 3: the codes
        beat1, beat2 = (Signal(form.beat_layout, reset_less=True) for _ in range(2))
        valid = Signal(2)
        m.d.sync += [
            valid.eq(Cat(self.i.valid, valid)),
            beat1.eq(beat),
            beat2.eq(beat1),
            self.o.valid.eq(valid[1]),
            self.o.payload.eq(beat2),
        ]
        for lane in lanes:
            left = keep[lane] & ~hidden[lane]
            m.d.sync += [
                self.kept[lane].eq(left),
                self.o.payload.codes[lane].eq(Mux(left, beat2.codes[lane], 0)),
            ]
        return m

    def _advance(self) -> tuple[Value, Value]:
        """Return when a beat passes, and whether it is its frame's last."""
        beat = self.i.payload
        return self.i.valid & ~beat.abort, beat.frame_end

    def _positions(self, m: Module) -> list[tuple[Value, Value]]:
        """Return row and column of each lane's pixel in the beat at the input."""
        form = self.form
        passes, ends = self._advance()
        abort = self.i.valid & self.i.payload.abort
        if form.cols % form.lanes == 0:
            # all lanes are in one row, and a lane's number is the low bits of its column
            row = Signal(range(form.rows))
            block = Signal(range(form.cols // form.lanes))
            self._step(m, row, block, form.cols // form.lanes, 1, passes, ends, abort)
            lane_bits = ceil_log2(form.lanes)
            return [(row, Cat(C(lane, lane_bits), block)) for lane in range(form.lanes)]
        positions: list[tuple[Value, Value]] = []
        for lane in range(form.lanes):
            row = Signal(range(form.rows + lane // form.cols + 1), init=lane // form.cols)
            row.name = f"row{lane}"
            col = Signal(range(form.cols), init=lane % form.cols, name=f"col{lane}")
            self._step(m, row, col, form.cols, form.lanes, passes, ends, abort)
            positions.append((row, col))
        return positions

    @staticmethod
    def _step(
        m: Module,
        row: Signal,
        col: Signal,
        cols: int,
        by: int,
        passes: Value,
        ends: Value,
        abort: Value,
    ) -> None:
        """Move a position on by `by` columns with each beat, back to its start after a frame."""
        whole, part = divmod(by, cols)
        with m.If(passes):
            with m.If(col >= cols - part):
                m.d.sync += [col.eq(col + part - cols), row.eq(row + whole + 1)]
            with m.Else():
                m.d.sync += [col.eq(col + part), row.eq(row + whole)]
        with m.If((passes & ends) | abort):
            m.d.sync += [row.eq(row.init), col.eq(col.init)]

    def _masked(self, m: Module) -> Value:
        """Return the mask bits of a beat's lanes, one clock after the beat."""
        form = self.form
        passes, ends = self._advance()
        per_word = MASK_WORD // form.lanes
        beat = Signal(range(form.beats))
        part = Signal(range(per_word))
        with m.If(passes):
            m.d.sync += beat.eq(beat + 1)
        with m.If((passes & ends) | (self.i.valid & self.i.payload.abort)):
            m.d.sync += beat.eq(0)
        m.d.sync += part.eq(beat)
        m.d.comb += self.mask_address.eq(beat >> ceil_log2(per_word))
        return self.mask_data.word_select(part, form.lanes)


class Window:
    """A first and a last, cut down to the bits that matter and held during a frame.

    Parameters
    ----------
    m : Module
        To which the registers are added.
    settings : View of WINDOW_LAYOUT
        As the host set them.
    count : int
        Values run from 0 to ``count - 1``.
    hold : Value
        Settings are not followed now.
    """

    def __init__(self, m: Module, settings: data.View, count: int, *, hold: Value) -> None:
        bits = ceil_log2(count)
        self.first = Signal(bits)
        self.last = Signal(bits)
        self.void = Signal()
        with m.If(~hold):
            m.d.sync += [
                self.first.eq(settings.first),
                self.last.eq(Mux(settings.last >> bits, -1, settings.last)),
                self.void.eq((settings.first >> bits).any()),
            ]

    def keeps(self, m: Module, value: Value) -> Value:
        """Return whether `value` is inside, one clock later."""
        low, high = Signal(), Signal()
        m.d.sync += [
            low.eq((value >= self.first) & ~self.void),
            high.eq(value <= self.last),
        ]
        return low & high
