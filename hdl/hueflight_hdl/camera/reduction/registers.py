# SPDX-License-Identifier: Apache-2.0
"""The registers of a camera that lead to its reduction."""

from __future__ import annotations

from amaranth.hdl import Module

from hueflight_protocol.registers import Register

from ...control.register_file import RegisterFile
from .reducer import Reducer

STORES = ("reduction_store", "reduction_move")
"""Registers that write into the memories of the core, which is refused during a capture."""


def lock_of(register: Register, indices: tuple[int, ...]) -> int | None:
    """Return which lock a register has, for `RegisterFile`: 0 is that of a capture.

    Parameters
    ----------
    register : Register
        A register of the camera.
    indices : tuple of int
        Which element of it.

    Returns
    -------
    int or None
        The lock's number; None if the register is never locked.
    """
    return 0 if register.name in STORES else None


def connect_registers(m: Module, registers: RegisterFile, reducer: Reducer) -> None:
    """Connect the registers of the reduction.

    Parameters
    ----------
    m : Module
        To which the connections are added.
    registers : RegisterFile
        Registers of the camera.
    reducer : Reducer
        Its reduction.
    """
    asked, room = reducer.asked, reducer.room
    m.d.comb += [
        asked.mode.eq(registers.reduction.mode),
        asked.sums.eq(registers.reduction.sums),
        asked.frames.eq(registers.reduction_frames.value),
        asked.first.eq(registers.reduction_codes.first),
        asked.last.eq(registers.reduction_codes.last),
        asked.tables.eq(registers.reduction_tables.value),
        asked.moved.eq(registers.reduction_moved.value),
        reducer.store_code.eq(registers.written_word),
        reducer.move_group.eq(registers.written_word),
    ]
    # a written 0 is no pulse, but the first code or group
    for name, write in zip(STORES, (reducer.store, reducer.move), strict=True):
        address = registers.registers[name].address
        m.d.comb += write.eq(registers.written & (registers.written_address == address))
    for k in range(room.sums):
        word = registers.reduction_entries[k // 2]
        m.d.comb += [
            asked.widths[k].eq(registers.reduction_width[k].value),
            reducer.entries[k].eq(word.odd if k % 2 else word.even),
        ]
    for pixel in range(room.group):
        word = registers.reduction_offsets[pixel // 4].value
        m.d.comb += reducer.offsets[pixel].eq(word.word_select(pixel % 4, 8))
