# SPDX-License-Identifier: Apache-2.0
"""Registers with which the host chooses the board's clock and learns of its failures."""

from __future__ import annotations

from amaranth.hdl import Module, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from ..common.counter import SaturatingCounter
from .register_file import RegisterFile

REFERENCE_STATE = data.StructLayout({"external": 1, "present": 1, "lost": 1})
"""State of the clock's choice, as the register ``clock_state``."""


def clock_members() -> dict[str, wiring.Member]:
    """Return the members of a board's logic that lead to the choice of its clock."""
    return {"reference_wanted": Out(1), "reference_state": In(REFERENCE_STATE)}


def connect_clock_choice(m: Module, registers: RegisterFile, state: data.View, /) -> Value:
    """Connect the registers of the clock; a loss is reported as soon as there are clocks again.

    Parameters
    ----------
    m : Module
        The module of the board's logic.
    registers : RegisterFile
        Registers of a build with an external clock.
    state : View
        See `REFERENCE_STATE`; asynchronous.

    Returns
    -------
    Value
        The host wants the external clock.
    """
    now = Signal(REFERENCE_STATE)
    lost_before = Signal()
    m.submodules.reference = FFSynchronizer(state.as_value(), now.as_value())
    m.d.sync += lost_before.eq(now.lost)
    m.d.comb += [
        *(getattr(registers.clock_state, name).eq(now[name]) for name in REFERENCE_STATE.members),
        registers.faults_set.reference_lost.eq(now.lost & ~lost_before),
    ]
    return registers.clock_source.external


def count_clock_failures(m: Module, registers: RegisterFile, failed: Value, /) -> None:
    """Count failures of the clock, and report them as a fault.

    Parameters
    ----------
    m : Module
        The module of the board's logic.
    registers : RegisterFile
        Its registers.
    failed : Value
        The clocks are not valid, or have not been for long. It falls with a clock of `sync`;
        after configuration it may begin high.
    """
    # only the falling edge is synchronous; the first one ends the start after configuration
    before, started = Signal(init=1), Signal()
    m.d.sync += before.eq(failed)
    with m.If(~failed):
        m.d.sync += started.eq(1)
    m.submodules.clock_failures = failures = SaturatingCounter(16)
    m.d.comb += [
        failures.event.eq(before & ~failed & started),
        registers.faults_set.clock_failed.eq(failures.event),
        registers.clock_failures.value.eq(failures.value),
    ]
