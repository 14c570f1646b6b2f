"""Steps through a program: which bank and which channels the next train has."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import enum, wiring
from amaranth.lib.wiring import In, Out

from .config import PulseConfig
from .program import step_layout


class _Phase(enum.Enum):
    OFF = 0
    SEEK = 1  # no step at hand: dark
    HOLD = 2  # dark until the first frame sync
    LIT = 3
    DARK = 4  # the step's idle time


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
        phase = Signal(_Phase)
        bank = Signal()
        mask = Signal(self.config.channels)
        marker = Signal(8)
        units = Signal(32)
        counting = Signal()  # trains of the present choice are units
        unit = Signal()
        last = self._is_last(m, units)
        has_idle = Signal()
        m.d.pulse += [
            has_idle.eq(self.idle_left.any()),
            unit.eq(counting & Mux(self.by_frame, self.frame, self.served)),
        ]

        # a unit has passed: the next one, the step's dark part, or the next step. Units are
        # `MIN_SPACING` clocks apart, so this may take several.
        darken = Signal()
        advance = Signal()
        lit = phase == _Phase.LIT
        m.d.pulse += [
            darken.eq(unit & last & lit & has_idle),
            advance.eq(unit & last & ~(lit & has_idle)),
        ]
        fewer = Signal(32)  # ready long before the next unit
        m.d.pulse += fewer.eq(units - 1)
        with m.If(unit):
            m.d.pulse += units.eq(fewer)
        with m.If(darken):
            m.d.pulse += [phase.eq(_Phase.DARK), units.eq(self.idle_left), self.idle_left.eq(0)]
        # the old choice stays in force until the next one is there, if it is at hand
        fresh = Signal()  # the program has not fired yet
        m.d.pulse += self.take.eq(0)
        with m.If(advance & ~self.ready):
            m.d.pulse += phase.eq(Mux(self.finished, _Phase.OFF, _Phase.SEEK))
        with m.Elif((advance | (phase == _Phase.SEEK)) & self.ready & ~self.take):
            m.d.pulse += self.take.eq(1)
        with m.Elif((phase == _Phase.SEEK) & self.finished):
            m.d.pulse += phase.eq(_Phase.OFF)
        with m.Elif((phase == _Phase.HOLD) & self.frame):
            m.d.pulse += phase.eq(_Phase.LIT)
        with m.If(self.take):
            m.d.pulse += [
                bank.eq(self.step.bank),
                mask.eq(self.step.mask),
                marker.eq(self.step.marker),
                units.eq(self.step.count),
                self.idle_left.eq(self.step.idle),
                self.number.eq(self.step.number),
                fresh.eq(0),
                phase.eq(Mux(fresh & self.by_frame, _Phase.HOLD, _Phase.LIT)),
            ]
        m.d.comb += self.rewind.eq(self.start)
        with m.If(self.start):
            m.d.pulse += [phase.eq(_Phase.SEEK), fresh.eq(1), self.take.eq(0)]
        with m.Elif(self.stop):
            m.d.pulse += [phase.eq(_Phase.OFF), self.take.eq(0)]
        with m.If(self.start | self.stop):
            m.d.pulse += [unit.eq(0), darken.eq(0), advance.eq(0)]

        # the choice
        manual = phase == _Phase.OFF
        m.d.pulse += [
            self.bank.eq(Mux(manual, self.manual_bank, bank)),
            self.mask.eq(Mux(manual, -1, Mux(lit, mask, 0))),
            self.marker.eq(Mux(lit, marker, 0)),
            self.running.eq(~manual),
            counting.eq(lit | (phase == _Phase.DARK)),
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
