# SPDX-License-Identifier: Apache-2.0
"""One serial lane: bit slip, word alignment, and a lag of a whole word."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .link_format import LinkFormat

LOCK_WORDS = 16
"""Training words in a row after which a lane counts as aligned."""
_SETTLE_WORDS = 4
"""Words after a slip until all of a word has been taken at the new place."""


class LaneAligner(wiring.Component):
    """Finds where the words of a lane begin, by its training word.

    The lane is delayed by a number of bits, one more after each word that is not the training
    word, until `LOCK_WORDS` were right. A lane that is a word ahead of the others is delayed by
    a whole word more. Everything is in the domain `sensor`.

    Members
    -------
    samples : In(gear)
        Bits of this clock, the earliest lowest.
    strobe : In(1)
        A word is taken in this clock; the same for all lanes, every `clocks_per_word` clocks.
    restart : In(1)
        Look for the words again.
    delay : In(1)
        Delay the lane by a word from now on: the same word comes again.
    word : Out(word_bits)
        The word of the last strobe, or the one before.
    locked : Out(1)
        Words are aligned.
    delayed : Out(1)
        The lane is delayed by a word.
    """

    def __init__(self, link: LinkFormat) -> None:
        self.link = link
        super().__init__(
            {
                "samples": In(link.gear),
                "strobe": In(1),
                "restart": In(1),
                "delay": In(1),
                "word": Out(link.word_bits),
                "locked": Out(1),
                "delayed": Out(1),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        link = self.link
        steps = link.clocks_per_word
        offset = Signal(range(link.gear))
        step = Signal(range(steps))  # clocks of delay below a word

        before = Signal(link.gear)
        slipped = Signal(link.gear)
        window = Cat(before, self.samples)
        m.d.sensor += [before.eq(self.samples), slipped.eq(window.bit_select(offset, link.gear))]

        chosen = Signal(link.gear)
        history = [slipped]
        for place in range(steps - 1):
            later = Signal(link.gear, name=f"history{place}")
            m.d.sensor += later.eq(history[-1])
            history.append(later)
        with m.Switch(step):
            for place, bits in enumerate(history):
                with m.Case(place):
                    m.d.sensor += chosen.eq(bits)

        gathered, now, last = (Signal(link.word_bits) for _ in range(3))
        m.d.sensor += gathered.eq(Cat(gathered[link.gear :], chosen))
        with m.If(self.strobe):
            m.d.sensor += [now.eq(gathered), last.eq(now)]
        m.d.comb += self.word.eq(Mux(self.delayed, last, now))

        self._align(m, offset, step)
        return m

    def _align(self, m: Module, offset: Signal, step: Signal) -> None:
        """Slip by a bit after each wrong word, until enough were right."""
        steps = self.link.clocks_per_word
        settle = Signal(range(_SETTLE_WORDS + 1), init=_SETTLE_WORDS)
        matches = Signal(range(LOCK_WORDS))
        with m.If(self.strobe & ~self.locked):
            with m.If(settle != 0):
                m.d.sensor += settle.eq(settle - 1)
            with m.Elif(self.word == self.link.training):
                m.d.sensor += [matches.eq(matches + 1), self.locked.eq(matches == LOCK_WORDS - 1)]
            with m.Else():
                m.d.sensor += [matches.eq(0), settle.eq(_SETTLE_WORDS), offset.eq(offset - 1)]
                with m.If(offset == 0):
                    m.d.sensor += step.eq(Mux(step == steps - 1, 0, step + 1))
        with m.If(self.delay):
            m.d.sensor += self.delayed.eq(1)
        with m.If(self.restart):
            m.d.sensor += [self.locked.eq(0), self.delayed.eq(0), matches.eq(0)]
            m.d.sensor += settle.eq(_SETTLE_WORDS)
