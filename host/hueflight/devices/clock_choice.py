# SPDX-License-Identifier: Apache-2.0
"""Which clock a board runs from: its own oscillator, or an external one."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

from hueflight.devices.board import Board
from hueflight.devices.errors import DeviceError, DeviceTimeoutError
from hueflight_protocol import RegisterValue
from hueflight_protocol.typed_registers import common as registers

ClockName = Literal["internal", "external"]
_PAUSE_S = 0.005


@dataclass(frozen=True)
class ClockState:
    """The clock of a board.

    Attributes
    ----------
    source : {"internal", "external"}
        Clock in use.
    reference_hz : int or None
        Frequency that an external clock must have, None if the build has no input for one.
    present : bool
        True if there is an external clock of that frequency.
    lost : bool
        True if the external clock was lost while in use and has not been chosen again.
    """

    source: ClockName
    reference_hz: int | None
    present: bool
    lost: bool


def read_clock(board: Board, /) -> ClockState:
    """Read which clock a board runs from.

    Parameters
    ----------
    board : Board
        The board, with the map of its build.

    Returns
    -------
    ClockState
        Its clock.
    """
    if registers.ClockState.ADDRESS not in board.registers:
        return ClockState("internal", None, present=False, lost=False)
    state = board.read(registers.ClockState)
    return ClockState(
        source="external" if state.external else "internal",
        reference_hz=board.read(registers.ReferenceHz).value,
        present=bool(state.present),
        lost=bool(state.lost),
    )


def choose_clock(
    board: Board, source: ClockName, fault: RegisterValue, /, *, timeout_s: float
) -> ClockState:
    """Change the clock of a board; see `Illuminator.choose_clock`.

    Parameters
    ----------
    board : Board
        The board, with the map of its build.
    source : {"internal", "external"}
        The clock.
    fault : RegisterValue
        The fault that a change sets, to be cleared.
    timeout_s : float
        Longest time for the change, in seconds.

    Returns
    -------
    ClockState
        State after the change.

    Raises
    ------
    DeviceError
        If the board has no external clock, none of the right frequency is there, or it fails
        during the change.
    """
    place = board.transport.name
    before = read_clock(board)
    if source == before.source:
        return before
    if before.reference_hz is None:
        raise DeviceError(
            f"the board at {place} was built without an external clock: build it with "
            "--set reference_hz=FREQUENCY"
        )
    if source == "external" and not before.present:
        raise DeviceError(
            f"there is no clock of {before.reference_hz} Hz at the input of the board at {place}: "
            "connect one, then choose it again"
        )
    board.write(registers.ClockSource(0))  # a request begins when it becomes 1
    if source == "external":
        board.write(registers.ClockSource(1))
    deadline = time.monotonic() + timeout_s
    while True:
        time.sleep(_PAUSE_S)  # the board does not answer while its clocks stand still
        try:
            state = read_clock(board)
        except DeviceTimeoutError:
            state = before
        if state.source == source:
            break
        if time.monotonic() > deadline or state.lost > before.lost:
            raise DeviceError(
                f"the board at {place} still runs from its {before.source} clock after "
                f"{timeout_s} s: check the external clock and choose it again"
            )
    board.write(fault)
    return state
