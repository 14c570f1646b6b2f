# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to sums in the camera: tables and offsets that it is given before a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.devices.board import Board
from hueflight.devices.errors import DeviceError
from hueflight_protocol import ReductionMode
from hueflight_protocol.reduction import ReductionTables, check_offsets, offsets_hash
from hueflight_protocol.typed_registers import camera as registers

NO_REDUCTION = "this camera's gateware can't reduce codes to sums: record codes instead"


@dataclass(frozen=True, eq=False)
class Reduction:
    """What a camera is to make of its codes.

    Attributes
    ----------
    tables : ReductionTables
        Tables of the reduction, as `hueflight.design_sums` makes them.
    frames : int
        Frames of a picture.
    offsets : ndarray of int, shape (row, col), or None
        Offset of each pixel in the tables, codes; None for none.
    with_codes : bool
        True to have the codes sent as well.
    middle_ns, reach_ns : float
        Delays that the tables are designed for, as `hueflight.reconstruction.SumsDesign` has them.
    """

    tables: ReductionTables
    frames: int
    offsets: NDArray[np.integer] | None = None
    with_codes: bool = False
    middle_ns: float = 0.0
    reach_ns: float = 0.0


def stop_reduction(board: Board) -> None:
    """Have the camera send codes, if it can send anything else.

    Parameters
    ----------
    board : Board
        Registers of the camera.
    """
    if registers.Reduction.ADDRESS in board.registers:
        board.write(registers.Reduction(mode=ReductionMode.CODES, sums=0))


def load_reduction(board: Board, reduction: Reduction, /, *, pixels: int) -> None:
    """Give a camera tables and offsets, and have it send sums from its next run on.

    Parameters
    ----------
    board : Board
        Registers of the camera.
    reduction : Reduction
        What it is to make of its codes.
    pixels : int
        Pixels of the camera.

    Raises
    ------
    DeviceError
        If the camera can't reduce codes, or has no room for the tables.
    ProtocolError
        If offsets are out of range.
    """
    if registers.Reduction.ADDRESS not in board.registers:
        raise DeviceError(NO_REDUCTION)
    tables = reduction.tables
    room = board.read(registers.ReductionRoom)
    wide = room.sums - board.read(registers.ReductionNarrow).value
    for what, needed, most in (
        ("sums per pixel", tables.sums, room.sums),
        ("bits of a table entry", tables.entry_bits, room.entry_bits),
        ("bits of a sum", max(tables.widths), room.sum_bits),
        (f"bits of sum {wide} and all after it", max(tables.widths[wide:], default=1),
         room.sum_bits - 1),
    ):  # fmt: skip
        if needed > most:
            raise DeviceError(
                f"the tables need {needed} {what}, the camera has room for {most}: design the "
                "sums with fewer"
            )
    if not 1 <= reduction.frames <= registers.ReductionFrames.VALUE_MAX:
        raise DeviceError(f"frames of a picture = {reduction.frames}: must be 1 or more")
    _store_tables(board, tables)
    offsets = check_offsets(reduction.offsets, tables, pixels)
    _store_offsets(board, offsets, room.group)
    board.write_elements(registers.ReductionWidth, list(tables.widths))
    for value in (
        registers.ReductionFrames(reduction.frames),
        registers.ReductionCodes(first=tables.first, last=tables.last),
        registers.ReductionTables(tables.hash),
        registers.ReductionMoved(offsets_hash(offsets)),
        registers.Reduction(
            mode=ReductionMode.BOTH if reduction.with_codes else ReductionMode.SUMS,
            sums=tables.sums,
        ),
    ):
        board.write(value)


def _store_tables(board: Board, tables: ReductionTables) -> None:
    """Store the entries of each code, two sums in a word."""
    even = tables.entries[::2].astype(np.uint32)
    odd = np.zeros_like(even)
    odd[: tables.sums // 2] = tables.entries[1::2]
    words = (even | odd << 16).T.tolist()
    for code, entries in enumerate(words):
        board.write_elements(registers.ReductionEntries, entries)
        board.write(registers.ReductionStore(code))


def _store_offsets(board: Board, offsets: NDArray[np.intp], group: int) -> None:
    """Store the offsets of each group of pixels, four in a word."""
    padded = np.zeros(-(-offsets.size // group) * group, np.int8)
    padded[: offsets.size] = offsets
    for number, words in enumerate(padded.view("<u4").reshape(-1, group // 4).tolist()):
        board.write_elements(registers.ReductionOffsets, words)
        board.write(registers.ReductionMove(number))
