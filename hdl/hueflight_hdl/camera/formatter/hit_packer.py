# SPDX-License-Identifier: Apache-2.0
"""Packs the nonzero codes (hits) of a chunk without gaps.

A prefix count gives the place of each hit in the packed sequence, a concentrator of three levels
moves it there, and an accumulator holds the group that is not full yet.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..frame_format import GROUP, FrameFormat
from .bank_cursor import BankCursor, group_write_layout

LEVELS = GROUP.bit_length() - 1


class HitPacker(wiring.Component):
    """Packs the hits of a chunk into at most one group per clock.

    A chunk's last group can complete one group and begin another: the second one waits a
    clock. Nothing waits longer, since a chunk has no more packed groups than groups.

    Members
    -------
    i : In(stream)
        Groups; never waits.
    o : Out(stream)
        Packed groups with the bank and place that they go to; cannot wait.
    tally : Out(stream)
        Hits of a chunk, aborted ones too; at most one packed group comes after it.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        super().__init__(
            {
                "i": In(stream.Signature(form.group_layout, always_ready=True)),
                "o": Out(stream.Signature(group_write_layout(form), always_ready=True)),
                "tally": Out(stream.Signature(tally_layout(form), always_ready=True)),
            }
        )
        self._step = data.StructLayout(
            {
                "codes": form.codes_layout(GROUP),
                "hit": GROUP,  # places that hold a code other than 0
                "target": data.ArrayLayout(LEVELS, GROUP),  # place each of them goes to
                "held": GROUP,  # places that the group begun has filled already
                "hits": range(GROUP + 1),
                "total": range(2 * GROUP),  # codes in the group begun, with these
                "end": 1,  # of the chunk
                "frame_end": 1,
                "abort": 1,
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        group = self.i.payload
        valid, step = self._next(m, self.i.valid, None, "masked")
        m.d.sync += [
            step.codes.eq(group.codes),
            step.end.eq(group.chunk_end | group.abort),
            step.frame_end.eq(group.frame_end),
            step.abort.eq(group.abort),
            *(step.hit[i].eq(group.codes[i].any() & ~group.abort) for i in range(GROUP)),
        ]
        valid, step = self._count(m, valid, step)
        valid, step = self._aim(m, valid, step)
        for level in range(LEVELS):
            valid, step = self._concentrate(m, valid, step, level)
        self._pack(m, valid, step)
        self._tally(m, valid, step)
        return m

    def _next(
        self, m: Module, valid: Value, step: data.View | None, name: str
    ) -> tuple[Signal, data.View]:
        """Return the next stage; what is not assigned to it later is handed on as it is."""
        valid_after = Signal(name=f"{name}_valid")
        after = Signal(self._step, name=name, reset_less=True)
        m.d.sync += valid_after.eq(valid)
        if step is not None:
            m.d.sync += after.eq(step)
        return valid_after, after

    def _count(self, m: Module, valid: Signal, step: data.View) -> tuple[Signal, data.View]:
        """Count the hits before each place."""
        valid, after = self._next(m, valid, step, "counted")
        for place in range(GROUP):
            m.d.sync += after.target[place].eq(_count_ones(step.hit[:place]))
        m.d.sync += after.hits.eq(_count_ones(step.hit))
        return valid, after

    def _aim(self, m: Module, valid: Signal, step: data.View) -> tuple[Signal, data.View]:
        """Turn counts into places; the packer's one loop is this sum modulo 8."""
        base = Signal(LEVELS)
        total = Signal(range(2 * GROUP))
        m.d.comb += total.eq(base + step.hits)
        with m.If(valid):
            m.d.sync += base.eq(Mux(step.end, 0, total))
        valid, after = self._next(m, valid, step, "aimed")
        m.d.sync += after.total.eq(total)
        for place in range(GROUP):
            m.d.sync += [
                after.target[place].eq(step.target[place] + base),
                after.held[place].eq(base > place),
            ]
        return valid, after

    def _concentrate(
        self, m: Module, valid: Signal, step: data.View, level: int
    ) -> tuple[Signal, data.View]:
        """Bring each hit to a place that equals its target in bit `level`.

        The targets rise by one from hit to hit, so that no two want the same place: a reverse
        banyan network, least significant bit first.
        """
        valid, after = self._next(m, valid, step, f"level{level}")
        for low in range(GROUP):
            high = low | 1 << level
            if low == high:
                continue
            swap = Signal(name=f"swap{level}_{low}")
            m.d.comb += swap.eq(
                (step.hit[low] & step.target[low][level])
                | (step.hit[high] & ~step.target[high][level])
            )
            for here, there in ((low, high), (high, low)):
                m.d.sync += [
                    after.codes[here].eq(Mux(swap, step.codes[there], step.codes[here])),
                    after.hit[here].eq(Mux(swap, step.hit[there], step.hit[here])),
                    after.target[here].eq(Mux(swap, step.target[there], step.target[here])),
                ]
        return valid, after

    def _pack(self, m: Module, valid: Signal, step: data.View) -> None:
        """Fill up the group that was begun; write it when it is full or the chunk ends."""
        form = self.form
        full = Signal()
        begun = Signal(form.codes_layout(GROUP), reset_less=True)
        filled, over = Signal.like(begun), Signal.like(begun)
        m.d.comb += full.eq(step.total[-1])
        for place in range(GROUP):
            m.d.comb += [
                filled[place].eq(Mux(step.held[place], begun[place], step.codes[place])),
                over[place].eq(Mux(step.held[place], step.codes[place], 0)),
            ]
        with m.If(valid):
            m.d.sync += begun.eq(Mux(full, over, filled))

        cursor = BankCursor(form)
        layout = group_write_layout(form)
        write = Signal(layout)
        late = Signal(layout, reset_less=True)
        write_now, write_late, waits = Signal(), Signal(), Signal()
        m.d.comb += [
            write_now.eq(valid & ~step.abort & (full | (step.end & step.total.any()))),
            write_late.eq(valid & ~step.abort & step.end & (step.total > GROUP)),
            write.bank.eq(cursor.bank),
            write.place.eq(cursor.place),
            write.codes.eq(filled),
        ]
        cursor.advance(m, valid, step.end, step.abort, by=write_now)
        m.d.sync += [
            self.o.valid.eq(waits | write_now),
            self.o.payload.eq(Mux(waits, late, write)),
            waits.eq(write_late | (waits & write_now)),
            late.eq(write),
        ]
        with m.If(write_late):
            m.d.sync += [late.codes.eq(over), late.place.eq(cursor.place + 1)]

    def _tally(self, m: Module, valid: Signal, step: data.View) -> None:
        """Add up a chunk's hits."""
        hits = Signal(self.form.hit_bits)
        total = Signal(self.form.hit_bits)
        tally = self.tally.payload
        m.d.comb += total.eq(hits + step.hits)
        with m.If(valid):
            m.d.sync += hits.eq(Mux(step.end, 0, total))
        m.d.sync += [
            self.tally.valid.eq(valid & step.end),
            tally.hits.eq(total),
            tally.frame_end.eq(step.frame_end),
            tally.abort.eq(step.abort),
        ]


def tally_layout(form: FrameFormat, /) -> data.StructLayout:
    """Return the layout of what is known of a chunk when all of it has come."""
    return data.StructLayout({"hits": form.hit_bits, "frame_end": 1, "abort": 1})


def _count_ones(bits: Value) -> Value:
    """Count in halves: a sum of eight in a row would be twice as deep."""
    if len(bits) < 2:
        return bits
    half = len(bits) // 2
    return _count_ones(bits[:half]) + _count_ones(bits[half:])
