# SPDX-License-Identifier: Apache-2.0
"""Steps through a program of banks, channel masks and markers."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .config import PulseConfig
from .program import step_layout


class Sequencer(wiring.Component):
    """Chooses bank, mask and marker of the next train.

    Without a program running they are `manual_bank`, all channels and 0. A step fires for
    `count` units, then is dark for `idle` units; a unit is a train, or a frame sync. With
    frame syncs, the first one begins the program. Dark trains of a program have marker 0.

    Members
    -------
    start, stop : In(1)
    by_frame : In(1)
        Units are frame syncs.
    frame : In(1)
        A frame sync; they are at least `MIN_SPACING` clocks apart.
    served : In(1)
        A train takes over the present choice.
    manual_bank : In(1)
    step, ready, finished : In
        See `ProgramReader`.
    rewind, take : Out(1)
        See `ProgramReader`.
    bank, mask, marker : Out
        Of the next train.
    running : Out(1)
    number : Out(8)
        Of the present step.
    left, idle_left : Out(32)
        Units to come in the lit and in the dark part of the present step.
    """

    def __init__(self, config: PulseConfig) -> None:
        self.config = config
        super().__init__(
            {
                "start": In(1),
                "stop": In(1),
                "by_frame": In(1),
                "frame": In(1),
                "served": In(1),
                "manual_bank": In(1),
                "step": In(step_layout(config)),
                "ready": In(1),
                "finished": In(1),
                "rewind": Out(1),
                "take": Out(1),
                "bank": Out(1),
                "mask": Out(config.channels),
                "marker": Out(8),
                "running": Out(1),
                "number": Out(8),
                "left": Out(32),
                "idle_left": Out(32),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # what the program is doing, one bit each; none of the last four is manual
        seek = Signal()  # no step at hand: dark
        hold = Signal()  # dark until the first frame sync
        lit = Signal()
        dark = Signal()  # the step's idle time
        running = Signal()

        # a unit has passed: is it the step's dark part that comes, or the next step? Units are
        # `MIN_SPACING` clocks apart, so the answer may take a few.
        units = Signal(32)
        fewer = Signal(32)
        idle_parts = Signal(8)
        has_idle = Signal()  # two clocks late, as `last` is
        counting = Signal()  # trains of the present choice are units
        unit = Signal()
        darken = Signal()
        advance = Signal()
        last = self._is_last(m, units)
        m.d.pulse += [
            fewer.eq(units - 1),
            *(idle_parts[i].eq(self.idle_left[4 * i : 4 * i + 4].any()) for i in range(8)),
            has_idle.eq(idle_parts.any()),
            unit.eq(counting & Mux(self.by_frame, self.frame, self.served)),
            darken.eq(unit & last & lit & has_idle),
            advance.eq(unit & last & ~(lit & has_idle)),
        ]
        with m.If(unit):
            m.d.pulse += units.eq(fewer)
        with m.If(darken):
            m.d.pulse += [units.eq(self.idle_left), self.idle_left.eq(0)]

        # the next step; the old choice stays in force until it is there, if it is at hand
        bank = Signal()
        mask = Signal(self.config.channels)
        marker = Signal(8)
        lost = Signal()
        over = Signal()
        wanted = advance | seek
        m.d.pulse += [
            self.take.eq(wanted & self.ready & ~self.take),
            lost.eq(advance & ~self.ready & ~self.finished),
            over.eq(wanted & self.finished),
        ]
        with m.If(self.take):
            m.d.pulse += [
                bank.eq(self.step.bank),
                mask.eq(self.step.mask),
                marker.eq(self.step.marker),
                units.eq(self.step.count),
                self.idle_left.eq(self.step.idle),
                self.number.eq(self.step.number),
            ]

        fresh = Signal()  # the program has not fired yet
        waits = Signal()  # so that it begins with a frame sync
        left_off = lost | over
        m.d.pulse += [
            fresh.eq(fresh & ~self.take),
            waits.eq(fresh & self.by_frame),
            seek.eq(lost | (seek & ~self.take & ~over)),
            hold.eq((self.take & waits) | (hold & ~self.frame)),
            lit.eq((self.take & ~waits) | (hold & self.frame) | (lit & ~darken & ~left_off)),
            dark.eq(darken | (dark & ~self.take & ~left_off)),
            running.eq(running & ~over),
        ]
        m.d.comb += self.rewind.eq(self.start)
        with m.If(self.start | self.stop):
            m.d.pulse += [
                *(event.eq(0) for event in (unit, darken, advance, self.take, lost, over)),
                *(state.eq(0) for state in (hold, lit, dark)),
                seek.eq(self.start),
                running.eq(self.start),
                fresh.eq(self.start),
            ]

        # the choice
        m.d.pulse += [
            self.bank.eq(Mux(running, bank, self.manual_bank)),
            self.mask.eq(Mux(running, Mux(lit, mask, 0), -1)),
            self.marker.eq(Mux(lit, marker, 0)),
            self.running.eq(running),
            counting.eq(lit | dark),
        ]
        m.d.comb += self.left.eq(Mux(self.running, units, 0))
        return m

    def _is_last(self, m: Module, units: Signal) -> Signal:
        """Return whether one unit is left, two clocks late."""
        ones = Signal(8)
        last = Signal()
        m.d.pulse += [
            ones[0].eq(units[0:4] == 1),
            *(ones[i].eq(units[4 * i : 4 * i + 4] == 0) for i in range(1, 8)),
            last.eq(ones.all()),
        ]
        return last
