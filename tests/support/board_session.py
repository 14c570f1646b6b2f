# SPDX-License-Identifier: Apache-2.0
"""Requests to a whole simulated board, and what its pins did."""

from __future__ import annotations

from dataclasses import dataclass

from hueflight_hdl.testbench.board import BoardRun, BoardScript
from hueflight_protocol import control
from hueflight_protocol.illuminator_map import illuminator_map
from hueflight_protocol.registers import RegisterMap

US = 1_000_000  # in picoseconds
MAP = illuminator_map(external_clock=True, fine_steps=128)


@dataclass(frozen=True)
class Board:
    """A board, and what its documents and the page on the illuminator say of it."""

    name: str
    family: str
    oscillator_hz: float
    tick_ps: int
    latency_ticks: int
    leds: int = 9


ULX3S = Board("ulx3s-85f", "ecp5", 25e6, 1250, 25 * 4)


class Session(BoardScript):
    """A script with numbered requests; each waits for its response."""

    def __init__(self, board: Board, *, trigger: int = 0, registers: RegisterMap = MAP) -> None:
        super().__init__()
        self.board = board
        self.registers = registers
        self.requests = 0
        self.set("trigger", trigger)
        self.wait(20 * US)  # the PLL locks

    def request(self, request: control.Request) -> int:
        """Send a request; return its place among the responses."""
        self.send(control.serial_frame(control.encode_request(request)))
        self.wait(180 * US)
        self.requests += 1
        return self.requests - 1

    def write(self, name: str, *words: int) -> int:
        return self.request(control.write(self.requests, self.registers[name].address, words))

    def read(self, name: str, count: int = 1) -> int:
        return self.request(control.read(self.requests, self.registers[name].address, count))

    def load(self, *, width: int = 8) -> None:
        """Load Table 1: nine pulses, 24 ticks apart, with another width."""
        # the map of every build has room for the same pulses; one that a build lacks is unknown
        for channel in range(self.board.leds):
            address = MAP["pulse"].address + 4 * channel
            self.request(control.write(self.requests, address, [24 * channel | width << 16]))
        self.write("bank_enable", (1 << self.board.leds) - 1)

    def trigger(self) -> int:
        """Send a trigger; return its time."""
        at = self.now_ps
        self.set("trigger", 1)
        self.wait(self.board.tick_ps * 8)
        self.set("trigger", 0)
        return at


def lit(run: BoardRun, start: int, stop: int) -> bool:
    """Whether any LED is on within a window."""
    before = [levels for time, levels in run.led if time <= start]
    return bool(before[-1]) or any(levels for time, levels in run.led if start < time < stop)
