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
    SETTLE = 2  # a step is at hand, its counters are not
    HOLD = 3  # dark until the first frame sync
    LIT = 4
    DARK = 5  # the step's idle time


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
        A train took over the present choice one clock ago.
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
        has_idle = Signal()
        fresh = Signal()  # the program has not fired yet
        settling = Signal(2)

        # a unit that the present choice was in force for
        counting = Signal()
        counted = Signal(2)
        unit = Signal()
        m.d.comb += [
            counting.eq((phase == _Phase.LIT) | (phase == _Phase.DARK)),
            unit.eq(counting & Mux(self.by_frame, self.frame, self.served & counted[1])),
        ]
        # `counted[1]` is `counting` as it was when the train of `served` was chosen: one clock
        # for the choice's register, one for the train's
        m.d.pulse += counted.eq(counting | counted << 1)

        # last unit of this phase; compared over two clocks, units are farther apart
        ones = Signal(8)
        last = Signal()
        m.d.pulse += [
            ones[0].eq(units[0:4] == 1),
            *(ones[i].eq(units[4 * i : 4 * i + 4] == 0) for i in range(1, 8)),
            last.eq(ones.all()),
            has_idle.eq(self.idle_left.any()),
        ]

        advance = Signal()
        m.d.pulse += self.take.eq(0)
        with m.If(unit):
            m.d.pulse += units.eq(units - 1)
            with m.If(last):
                with m.If((phase == _Phase.LIT) & has_idle):
                    m.d.pulse += [
                        phase.eq(_Phase.DARK),
                        units.eq(self.idle_left),
                        self.idle_left.eq(0),
                    ]
                with m.Else():
                    m.d.comb += advance.eq(1)
        with m.If(advance | (phase == _Phase.SEEK)):
            with m.If(self.ready & ~self.take):
                m.d.pulse += [
                    bank.eq(self.step.bank),
                    mask.eq(self.step.mask),
                    marker.eq(self.step.marker),
                    units.eq(self.step.count),
                    self.idle_left.eq(self.step.idle),
                    self.number.eq(self.step.number),
                    self.take.eq(1),
                    settling.eq(3),
                    phase.eq(Mux(advance, _Phase.LIT, _Phase.SETTLE)),
                ]
            with m.Elif(self.finished):
                m.d.pulse += phase.eq(_Phase.OFF)
            with m.Else():
                m.d.pulse += phase.eq(_Phase.SEEK)
        with m.Elif(phase == _Phase.SETTLE):
            m.d.pulse += settling.eq(settling - 1)
            with m.If(settling == 0):
                m.d.pulse += phase.eq(Mux(fresh & self.by_frame, _Phase.HOLD, _Phase.LIT))
                m.d.pulse += fresh.eq(0)
        with m.Elif((phase == _Phase.HOLD) & self.frame):
            m.d.pulse += phase.eq(_Phase.LIT)
        m.d.comb += self.rewind.eq(self.start)
        with m.If(self.start):
            m.d.pulse += [phase.eq(_Phase.SEEK), fresh.eq(1), self.number.eq(0)]
        with m.Elif(self.stop):
            m.d.pulse += phase.eq(_Phase.OFF)

        # the choice
        manual = phase == _Phase.OFF
        lit = phase == _Phase.LIT
        m.d.pulse += [
            self.bank.eq(Mux(manual, self.manual_bank, bank)),
            self.mask.eq(Mux(manual, -1, Mux(lit, mask, 0))),
            self.marker.eq(Mux(lit, marker, 0)),
            self.running.eq(~manual),
        ]
        m.d.comb += self.left.eq(Mux(manual, 0, units))
        return m
