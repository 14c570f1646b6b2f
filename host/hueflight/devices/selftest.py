# SPDX-License-Identifier: Apache-2.0
"""What the self-tests of all boards share: their results, the control line, the temperature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hueflight.devices.board import Board
from hueflight_protocol.typed_registers import common
from hueflight_protocol.wire import TEMPERATURE_UNKNOWN

WORDS = 2000
"""Words that are written and read again on the line."""
HOTTEST_MDEG = 85_000
"""Most that the junction of a commercial part may have. # Ref: Lattice FPGA-DS-02012."""


@dataclass(frozen=True)
class SelfTestResult:
    """The result of one test.

    Attributes
    ----------
    name : str
        What was tested.
    passed : bool
        True if the bound holds.
    measured, bound : str
        What was found, and what it must be.
    """

    name: str
    passed: bool
    measured: str
    bound: str

    def as_dict(self) -> dict[str, Any]:
        """Return the attributes by name."""
        return asdict(self)


Tell = Callable[[SelfTestResult], None]
"""Called with each result."""


def line_test(board: Board, words: int, /) -> SelfTestResult:
    """Test that random words come back, and that no message was damaged or sent again.

    Parameters
    ----------
    board : Board
        Registers of the board.
    words : int
        Words that are written and read again.

    Returns
    -------
    SelfTestResult
        The result.
    """
    before, repeated = board.read(common.RequestErrors), board.repeated
    wrong = 0
    for word in np.random.default_rng(1).integers(0, 1 << 32, words):
        board.write(common.Scratch(int(word)))
        wrong += board.read(common.Scratch).value != word
    after = board.read(common.RequestErrors)
    damaged = after.crc - before.crc + after.framing - before.framing
    repeated = board.repeated - repeated  # answers that were damaged on their way, too
    return SelfTestResult(
        "line",
        not wrong and not damaged and not repeated,
        f"{wrong} of {words} words wrong, {damaged} messages damaged, {repeated} sent again",
        "none",
    )


def temperature_test(board: Board, /) -> SelfTestResult:
    """Test that the temperature is known and not too high, of a board that measures it.

    Parameters
    ----------
    board : Board
        Registers of the board.

    Returns
    -------
    SelfTestResult
        The result.
    """
    found = board.read(common.Temperature).value
    known = found != TEMPERATURE_UNKNOWN
    return SelfTestResult(
        "temperature",
        known and found <= HOTTEST_MDEG,
        f"{found / 1000:g} °C" if known else "unknown: the sensor gives no valid code",
        f"at most {HOTTEST_MDEG / 1000:g} °C",
    )
