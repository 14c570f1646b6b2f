# SPDX-License-Identifier: Apache-2.0
"""The clock is exchanged only while everything is stopped, and a lost one is never in use."""

from __future__ import annotations

from amaranth.hdl import Assert, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ..boards.reference_clock import ReferenceSupervisor

SETTLE = 3
PATIENCE = 5
INTERVAL = 4.0


class ReferenceHarness(wiring.Component):
    """A supervisor whose external clock and host do anything."""

    def __init__(self) -> None:
        self.supervisor = ReferenceSupervisor(interval=INTERVAL, settle=SETTLE, patience=PATIENCE)
        super().__init__({"divided": In(1), "wanted": In(1), "locked": In(1)})

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of what is free."""
        return tuple(self.signature.members)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.supervisor = supervisor = self.supervisor
        select, hold = supervisor.select, supervisor.hold
        m.d.comb += [getattr(supervisor, name).eq(getattr(self, name)) for name in self.inputs]
        select_before, hold_before, divided_before = Signal(), Signal(), Signal()
        m.d.sync += [
            select_before.eq(select),
            hold_before.eq(hold),
            divided_before.eq(self.divided),
        ]
        changed = Signal()
        m.d.comb += changed.eq(select != select_before)

        # clocks in which everything was stopped, and the source stayed
        held = Signal(range(SETTLE + 1))
        more = Signal.like(held)
        m.d.comb += more.eq(Mux(held == SETTLE, SETTLE, held + 1))
        m.d.sync += held.eq(Mux(~hold, 0, Mux(changed, 1, more)))
        with m.If(changed):
            m.d.comb += [Assert(hold & hold_before), Assert(held == SETTLE)]
        with m.If(hold_before & ~hold):
            m.d.comb += Assert(held == SETTLE)

        # clocks without a change of the external clock, without a wish for it, without a lock
        latency = supervisor.latency
        still, unwanted = Signal(range(latency + 1)), Signal(range(3 * SETTLE + 8))
        unlocked = Signal(range(PATIENCE + 4))
        with m.If(self.divided != divided_before):
            m.d.sync += still.eq(0)
        with m.Elif(still != latency):
            m.d.sync += still.eq(still + 1)
        with m.If(self.wanted):
            m.d.sync += unwanted.eq(0)
        with m.Elif(unwanted != 3 * SETTLE + 7):
            m.d.sync += unwanted.eq(unwanted + 1)
        with m.If(self.locked | hold):
            m.d.sync += unlocked.eq(0)
        with m.Elif(unlocked != PATIENCE + 3):
            m.d.sync += unlocked.eq(unlocked + 1)
        with m.If(select & ~hold):
            m.d.comb += [
                Assert(still != latency),
                Assert(unwanted != 3 * SETTLE + 7),
                Assert(unlocked != PATIENCE + 3),
            ]
        return m
