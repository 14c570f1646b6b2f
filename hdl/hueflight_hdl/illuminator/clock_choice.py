# SPDX-License-Identifier: Apache-2.0
"""Registers with which the host chooses the board's clock."""

from __future__ import annotations

from amaranth.hdl import Module, Signal, Value
from amaranth.lib import data
from amaranth.lib.cdc import FFSynchronizer

from ..control.register_file import RegisterFile

REFERENCE_STATE = data.StructLayout({"external": 1, "present": 1, "lost": 1})
"""State of the clock's choice, as the register ``clock_state``."""


def connect_clock_choice(m: Module, registers: RegisterFile, state: data.View, /) -> Value:
    """Connect the registers of the clock; a loss is reported as soon as there are clocks again.

    Parameters
    ----------
    m : Module
        The module of the illuminator.
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
