# SPDX-License-Identifier: Apache-2.0
"""Supervision of an external clock: whether it is there, and when the PLL runs from it."""

from __future__ import annotations

import math

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

SHORTEST_HALF = 4
"""Clocks of the oscillator between changes of the divided external clock, at least: sampling
must not miss one."""
WINDOW_EDGES = 256
"""Changes over which the frequency is measured."""
WINDOW_TOLERANCE = 1 / 64
"""Largest relative error of the frequency."""
SETTLE_S = 1.1e-3
"""Reset of the PLL before and after its clock is exchanged; its data sheet asks for 1 ms."""
LOCK_S = 20e-3
"""Time in which the PLL must lock to the external clock; its data sheet states at most 15 ms."""


def divider_bits(clock_hz: float, reference_hz: float, /) -> int:
    """Return the bits of the counter that divides the external clock.

    Parameters
    ----------
    clock_hz, reference_hz : float
        Frequencies of the oscillator and of the external clock.
    """
    halvings = math.log2(SHORTEST_HALF * reference_hz / clock_hz)
    return max(0, math.ceil(halvings)) + 1


class ReferenceSupervisor(wiring.Component):
    """Watches an external clock, and decides when the PLL runs from it.

    It runs from the board's oscillator. An external clock is *present* while its changes come
    regularly and the last `WINDOW_EDGES` of them took the right time. A request is accepted when
    `wanted` rises while it is present. A change of the source waits for `settle` clocks, in which
    the answer to the request is sent; then `hold` resets the PLL, which stops all clocks of the
    board and releases its LEDs, `select` changes in the middle of that, and `hold` ends. When an
    external clock in use fails, `hold` comes at once, the oscillator takes over, and the request
    is dropped: it must be made again. So it is when the PLL does not lock to it.

    Parameters
    ----------
    interval : float
        Clocks between changes of the divided external clock, at least `SHORTEST_HALF`.
    settle : int
        Clocks before, and again after, `select` changes while `hold` is high.
    patience : int
        Clocks in which the PLL must lock to the external clock.

    Members
    -------
    divided : In(1)
        The divided external clock, synchronized.
    wanted : In(1)
        The host wants the external clock.
    locked : In(1)
        The PLL has locked, synchronized.
    select : Out(1)
        The PLL runs from the external clock.
    hold : Out(1)
        Resets the PLL and stops the board's clocks.
    present : Out(1)
        There is an external clock of the right frequency.
    lost : Out(1)
        It was lost while in use, and has not been asked for since.
    """

    def __init__(self, *, interval: float, settle: int, patience: int) -> None:
        self.interval = interval
        self.settle = settle
        self.patience = patience
        self.accepted = Signal()
        self.timer = Signal(range(settle + 1), init=settle)
        super().__init__(
            {
                "divided": In(1),
                "wanted": In(1),
                "locked": In(1),
                "select": Out(1),
                "hold": Out(1),
                "present": Out(1),
                "lost": Out(1),
            }
        )

    @property
    def latency(self) -> int:
        """Clocks from the last change of an external clock in use to `hold`, at most."""
        return self._longest + 3

    @property
    def _longest(self) -> int:
        """Clocks between two changes as they are sampled, at most."""
        return math.ceil(self.interval) + 1

    def elaborate(self, platform: object) -> Module:
        m = Module()
        irregular = self._watch(m)
        wanted_before = Signal()
        fails = Signal()
        waited = Signal(range(self.patience + 1))
        with m.If(self.hold | self.locked | ~self.select):
            m.d.sync += waited.eq(0)
        with m.Elif(waited != self.patience):
            m.d.sync += waited.eq(waited + 1)
        # also while the board still runs from it, after the host has asked for the oscillator
        m.d.comb += fails.eq(
            ((self.accepted | self.select) & (irregular | ~self.present))
            | (waited == self.patience)
        )
        m.d.sync += wanted_before.eq(self.wanted)
        with m.If(~self.wanted | fails):
            m.d.sync += self.accepted.eq(0)
        with m.Elif(~wanted_before):
            m.d.sync += self.accepted.eq(self.present & ~irregular)
        with m.If(self.wanted & ~wanted_before):
            m.d.sync += self.lost.eq(0)
        with m.If(fails & self.select):
            m.d.sync += self.lost.eq(1)
        self._switch(m)
        return m

    def _watch(self, m: Module) -> Signal:
        """Measure intervals and frequency; return whether an interval is wrong in this clock."""
        shortest, longest = math.floor(self.interval) - 1, self._longest
        before = Signal()
        change = Signal()
        since = Signal(range(longest + 1))  # clocks since the last change, but for this one
        irregular = Signal()
        m.d.sync += before.eq(self.divided)
        m.d.comb += [
            change.eq(self.divided ^ before),
            irregular.eq((change & (since + 1 < shortest)) | (~change & (since + 1 > longest))),
        ]
        with m.If(change):
            m.d.sync += since.eq(0)
        with m.Elif(since != longest):
            m.d.sync += since.eq(since + 1)

        exact = WINDOW_EDGES * self.interval
        few = math.floor(exact * (1 - WINDOW_TOLERANCE)) - 1
        many = math.ceil(exact * (1 + WINDOW_TOLERANCE)) + 1
        changes = Signal(range(WINDOW_EDGES))
        clocks = Signal(range(many + longest + 2))
        m.d.sync += clocks.eq(clocks + 1)
        with m.If(change):
            m.d.sync += changes.eq(changes + 1)
            with m.If(changes == WINDOW_EDGES - 1):
                m.d.sync += [
                    self.present.eq((clocks + 1 >= few) & (clocks + 1 <= many)),
                    changes.eq(0),
                    clocks.eq(0),
                ]
        with m.If(irregular | (clocks > many)):
            m.d.sync += [self.present.eq(0), changes.eq(0), clocks.eq(0)]
        return irregular

    def _switch(self, m: Module) -> None:
        """Exchange the clock while the PLL is in reset."""
        with m.If(~self.hold & (self.accepted == self.select)):
            m.d.sync += self.timer.eq(self.settle)
        with m.Elif(self.timer != 0):
            m.d.sync += self.timer.eq(self.timer - 1)
        with m.If(~self.hold):
            with m.If((self.accepted != self.select) & ((self.timer == 0) | self.lost)):
                m.d.sync += [self.hold.eq(1), self.timer.eq(self.settle)]
        with m.Elif(self.timer == 0):
            m.d.sync += self.timer.eq(self.settle)
            with m.If(self.accepted == self.select):
                m.d.sync += self.hold.eq(0)
            with m.Else():
                m.d.sync += self.select.eq(self.accepted)
