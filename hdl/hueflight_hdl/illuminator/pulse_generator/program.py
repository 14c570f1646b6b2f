# SPDX-License-Identifier: Apache-2.0
"""Prefetches sequencer programs: finds the next step that is not skipped."""

from __future__ import annotations

from amaranth.hdl import Array, Module, Mux, Signal, Value
from amaranth.lib import data, enum, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out
from amaranth.utils import ceil_log2

from .config import PulseConfig

WORDS_PER_STEP = 4
_LUT_DEPTH = 16
"""Of a memory that is one LUT a bit."""


class _State(enum.Enum):
    END = 0
    SEEK = 1
    LOAD = 2
    LOOK = 3
    FETCH = 4
    CHECK = 5
    OFFER = 6
    WAIT = 7


def step_layout(config: PulseConfig) -> data.StructLayout:
    """Return the layout of a program step."""
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
    """Prefetches the next step of the program.

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
        number = Signal(8)
        at_end = Signal()
        nonzero = Signal(8)
        counts = Signal()  # the step to be fetched has trains
        state = Signal(_State)
        # memories made of LUTs spread wide: their address is a register of nothing else
        address = Signal(range(self.config.steps))
        words = [self._memory(m, word, address) for word in range(WORDS_PER_STEP)]
        setup, mask, count, idle = words
        m.d.pulse += [
            address.eq(number),
            at_end.eq(number >= self.length),
            *(nonzero[i].eq(count[4 * i : 4 * i + 4].any()) for i in range(8)),
            counts.eq(nonzero.any()),
        ]
        with m.Switch(state):
            with m.Case(_State.SEEK):  # `address` is one clock late
                m.d.pulse += state.eq(_State.LOAD)
            with m.Case(_State.LOAD):  # and so are `at_end` and the memories
                m.d.pulse += state.eq(_State.LOOK)
            with m.Case(_State.LOOK):
                with m.If(~at_end):
                    m.d.pulse += state.eq(_State.FETCH)
                with m.Elif(self.loop):
                    m.d.pulse += [number.eq(0), state.eq(_State.SEEK)]
                with m.Else():
                    m.d.pulse += [self.finished.eq(1), state.eq(_State.END)]
            with m.Case(_State.FETCH):
                m.d.pulse += [number.eq(number + 1), state.eq(_State.CHECK)]
            with m.Case(_State.CHECK):  # the next step's words are late by this clock too
                m.d.pulse += state.eq(_State.OFFER)
            with m.Case(_State.OFFER):
                m.d.pulse += self.ready.eq(counts)
                m.d.pulse += state.eq(Mux(counts, _State.WAIT, _State.LOOK))
            with m.Case(_State.WAIT):
                with m.If(self.take):
                    m.d.pulse += [self.ready.eq(0), state.eq(_State.LOOK)]
        # one register enables a hundred others, far apart; what was fetched still stands
        fetched = Signal()
        m.d.pulse += fetched.eq(state == _State.FETCH)
        with m.If(fetched):
            m.d.pulse += [
                self.step.number.eq(address),
                self.step.bank.eq(setup[0]),
                self.step.marker.eq(setup[8:16]),
                self.step.mask.eq(mask),
                self.step.count.eq(count),
                self.step.idle.eq(idle),
            ]
        with m.If(self.rewind):
            m.d.pulse += [
                number.eq(0),
                self.ready.eq(0),
                self.finished.eq(0),
                state.eq(_State.SEEK),
            ]
        return m

    def _memory(self, m: Module, word: int, address: Signal) -> Value:
        """Return one of a step's words, one clock after its address.

        A memory made of LUTs is several, each as deep as one LUT and with registers of its own:
        the choice between them comes one clock later, when the address still stands.
        """
        attributes = {"ram_style": self.memory_style} if self.memory_style else {}
        depth = self.config.steps
        if self.memory_style == "distributed":
            depth = min(depth, _LUT_DEPTH)
        low = ceil_log2(depth)
        loaded = []
        for part in range(-(-self.config.steps // depth)):
            memory = Memory(shape=32, depth=depth, init=[], attrs=attributes)
            m.submodules[f"memory{word}_{part}"] = memory
            store = memory.write_port(domain="sync")
            load = memory.read_port(domain="pulse")
            written = self.address[2:]
            m.d.comb += [
                store.en.eq(self.write & (self.address[:2] == word) & (written[low:] == part)),
                store.addr.eq(written),
                store.data.eq(self.word),
                load.en.eq(1),
                load.addr.eq(address),
            ]
            loaded.append(load.data)
        return Array(loaded)[address[low:]] if len(loaded) > 1 else loaded[0]
