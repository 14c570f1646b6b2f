"""Reads a sequencer program ahead: finds the next step that is not skipped."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, enum, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from .config import PulseConfig

WORDS_PER_STEP = 4
_LAST_BEAT = WORDS_PER_STEP  # the memory answers one clock after its address


class _State(enum.Enum):
    END = 0
    SEEK = 1
    LOOK = 2
    READ = 3
    CHECK = 4
    OFFER = 5
    WAIT = 6


def step_layout(config: PulseConfig) -> data.StructLayout:
    """One step of a program."""
    return data.StructLayout(
        {
            "number": 8,
            "bank": 1,
            "marker": 8,
            "mask": config.channels,
            "count": 32,
            "idle": 32,
        }
    )


class ProgramReader(wiring.Component):
    """Keeps the next step of the program at hand.

    Members
    -------
    write : In(1), address : In, word : In(32)
        Writes the program, in the clock domain `sync`; four words a step: bank and marker,
        mask, count, idle.
    length : In(8)
        Steps in the program.
    loop : In(1)
    rewind : In(1)
        Begin at step 0.
    take : In(1)
        The step was taken over; find the one after it.
    step : Out
    ready : Out(1)
        `step` is the next one.
    finished : Out(1)
        There is no further step.
    """

    def __init__(self, config: PulseConfig, *, memory_style: str | None = None) -> None:
        self.config = config
        self.memory_style = memory_style
        super().__init__(
            {
                "write": In(1),
                "address": In(range(config.steps * WORDS_PER_STEP)),
                "word": In(32),
                "length": In(8),
                "loop": In(1),
                "rewind": In(1),
                "take": In(1),
                "step": Out(step_layout(config)),
                "ready": Out(1),
                "finished": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        attributes = {"ram_style": self.memory_style} if self.memory_style else {}
        memory = Memory(
            shape=32, depth=self.config.steps * WORDS_PER_STEP, init=[], attrs=attributes
        )
        m.submodules.memory = memory
        store = memory.write_port(domain="sync")
        load = memory.read_port(domain="pulse")
        m.d.comb += [
            store.en.eq(self.write),
            store.addr.eq(self.address),
            store.data.eq(self.word),
            load.en.eq(1),
        ]

        number = Signal(8)
        at_end = Signal()
        beat = Signal(range(_LAST_BEAT + 1))
        nonzero = Signal(8)
        state = Signal(_State)
        m.d.pulse += [
            at_end.eq(number >= self.length),
            *(nonzero[i].eq(self.step.count[4 * i : 4 * i + 4].any()) for i in range(8)),
        ]
        with m.Switch(state):
            with m.Case(_State.SEEK):  # `at_end` is up to date one clock later
                m.d.pulse += state.eq(_State.LOOK)
            with m.Case(_State.LOOK):
                m.d.pulse += [beat.eq(0), load.addr.eq(number * WORDS_PER_STEP)]
                with m.If(~at_end):
                    m.d.pulse += state.eq(_State.READ)
                with m.Elif(self.loop):
                    m.d.pulse += [number.eq(0), state.eq(_State.SEEK)]
                with m.Else():
                    m.d.pulse += [self.finished.eq(1), state.eq(_State.END)]
            with m.Case(_State.READ):
                m.d.pulse += [beat.eq(beat + 1), load.addr.eq(load.addr + 1)]
                self._capture(m, beat, load.data)
                with m.If(beat == _LAST_BEAT):
                    m.d.pulse += [
                        self.step.number.eq(number),
                        number.eq(number + 1),
                        state.eq(_State.CHECK),
                    ]
            with m.Case(_State.CHECK):  # so is `nonzero`
                m.d.pulse += state.eq(_State.OFFER)
            with m.Case(_State.OFFER):
                m.d.pulse += self.ready.eq(nonzero.any())
                m.d.pulse += state.eq(Mux(nonzero.any(), _State.WAIT, _State.LOOK))
            with m.Case(_State.WAIT):
                with m.If(self.take):
                    m.d.pulse += [self.ready.eq(0), state.eq(_State.LOOK)]
        with m.If(self.rewind):
            m.d.pulse += [
                number.eq(0),
                self.ready.eq(0),
                self.finished.eq(0),
                state.eq(_State.SEEK),
            ]
        return m

    def _capture(self, m: Module, beat: Signal, word: Signal) -> None:
        fields = (
            [self.step.bank.eq(word[0]), self.step.marker.eq(word[8:16])],
            [self.step.mask.eq(word)],
            [self.step.count.eq(word)],
            [self.step.idle.eq(word)],
        )
        for index, assignments in enumerate(fields):
            with m.If(beat == index + 1):
                m.d.pulse += assignments
