# SPDX-License-Identifier: Apache-2.0
"""The part of the control interface that both boards share: engine and status registers."""

from __future__ import annotations

from amaranth.hdl import Const, Module, Signal, ValueLike

from hueflight_protocol.wire import TEMPERATURE_UNKNOWN

from ..common.counter import SaturatingCounter
from .engine import ControlEngine
from .register_file import RegisterFile

UNKNOWN = Const(TEMPERATURE_UNKNOWN & 0xFFFF_FFFF, 32)
"""Temperature of a board that does not measure it."""


def add_control(
    m: Module, registers: RegisterFile, *, clock_ratio: int = 1, temperature: ValueLike = UNKNOWN
) -> ControlEngine:
    """Add a control engine for a register file, and connect the common status registers.

    Parameters
    ----------
    m : Module
        The register file becomes its submodule ``registers``, the engine ``control``.
    registers : RegisterFile
    clock_ratio : int
        Device clocks (as `clock_hz` has it) in one clock of `sync`.
    temperature : ValueLike
        Temperature in millidegrees Celsius, by default not measured.

    Returns
    -------
    ControlEngine
        Its streams are left to connect to a link.
    """
    m.submodules.registers = registers
    m.submodules.control = engine = ControlEngine()
    m.d.comb += [
        registers.address.eq(engine.address),
        registers.reading.eq(engine.reading),
        registers.write.eq(engine.write),
        registers.write_word.eq(engine.write_word),
        engine.exists.eq(registers.exists),
        engine.writable.eq(registers.writable),
        engine.refused.eq(registers.refused),
        engine.word.eq(registers.word),
    ]

    uptime = Signal(64)
    m.d.sync += uptime.eq(uptime + clock_ratio)
    m.d.comb += [
        registers.uptime.value.eq(uptime),
        registers.temperature.value.eq(temperature),
    ]
    for name, event, value in (
        ("requests", engine.answered, registers.requests.value),
        ("crc_errors", engine.crc_error, registers.request_errors.crc),
        ("framing_errors", engine.framing_error, registers.request_errors.framing),
    ):
        counter = SaturatingCounter(len(value))
        m.submodules[name] = counter
        m.d.comb += [counter.event.eq(event), value.eq(counter.value)]
    return engine
