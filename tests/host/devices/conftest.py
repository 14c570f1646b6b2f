# SPDX-License-Identifier: Apache-2.0
"""A board in software behind a pseudo terminal: what a serial port is, without the wire."""

from __future__ import annotations

import os
import re
import select
import termios
import threading
from collections.abc import Callable, Iterator

import pytest

from hueflight_protocol import CobsDecoder, Register, RegisterFile, illuminator_map, serial_frame
from hueflight_protocol.control import MAX_COBS_BYTES
from hueflight_protocol.illuminator_map import ARM_KEY

Spoil = Callable[[bytes], bytes]


class SoftwareIlluminator:
    """Registers that act as the gateware's do, as far as a driver sees."""

    def __init__(self, **size: int) -> None:
        self.registers = RegisterFile(
            illuminator_map(**size), on_write=self._wrote, refuses=self._refuses
        )
        for channel in range(size.get("channels", 9)):
            self.registers.set("limit", channel, on_ticks=80, burst_ticks=80, duty_divisor=8)
        self.registers.set("serial", value=0xBEEF)
        for feature, size_of in (
            ("external_clock", "external_clock"),
            ("fine_delay", "fine_steps"),
        ):
            if size.get(size_of):
                self.registers.set("features", **{feature: 1})
        self.dies_on_change = False

    def state(self, field: str) -> int:
        return self.registers.registers["state"].decode(self.registers.get("state"))[field]

    def _refuses(self, register: Register, indices: tuple[int, ...], word: int) -> bool:
        used = register.name in ("pulse", "bank_period", "bank_enable") and (
            indices[0] == self.registers.get("bank_select")
        )
        return (used or register.name == "fine_delay") and bool(self.state("armed"))

    def _wrote(self, register: Register, indices: tuple[int, ...], word: int) -> None:
        file = self.registers
        match register.name:
            case "arm":
                file.set("state", armed=int(word == ARM_KEY and file.get("watchdog_ms") > 0))
            case "clock_source":
                self._change_clock(word)
            case "sequencer_control" if word & 3:
                file.set("state", sequencing=word & 1)
            case "trigger_now":
                for name in ("triggers_seen", "triggers_served"):
                    file.set(name, value=file.get(name) + 1)
            case "clear" if word & 1:
                for name in ("triggers_seen", "triggers_served", "triggers_ignored"):
                    file.set(name, value=0)

    def connect_clock(self, present: bool) -> None:
        """Connect an external clock, or take it away: the board then uses its own."""
        state = self.registers.registers["clock_state"].decode(self.registers.get("clock_state"))
        lost = int((not present and state["external"]) or state["lost"])
        self.registers.set("clock_state", present=int(present), external=0, lost=lost)
        if lost:
            self.registers.set("faults", clock_failed=1, reference_lost=1)

    def _change_clock(self, word: int) -> None:
        state = self.registers.registers["clock_state"].decode(self.registers.get("clock_state"))
        wanted = word & state["present"]
        if wanted != state["external"] and not self.dies_on_change:
            self.registers.set("clock_state", external=wanted, lost=0)
            self.registers.set("faults", clock_failed=1)
            self.registers.set("state", armed=0)


class PtyBoard:
    """Answers on a pseudo terminal until closed.

    Attributes
    ----------
    path : what a driver opens.
    spoil : done to every frame that is sent; by default nothing.
    baud : rate at which it understands and answers; by default any.
    """

    def __init__(self, board: SoftwareIlluminator) -> None:
        self.board = board
        self.baud: int | None = None
        self.spoil: Spoil = lambda frame: frame
        self._master, self._slave = os.openpty()
        self.path = os.ttyname(self._slave)
        self._wake, self._ends = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Put bytes on the line that nobody asked for."""
        os.write(self._master, data)

    def _serve(self) -> None:
        decoder = CobsDecoder(limit=MAX_COBS_BYTES)
        while True:
            ready, _, _ = select.select([self._master, self._wake], [], [])
            if self._wake in ready:
                return
            before = decoder.damaged + decoder.overlong
            received = os.read(self._master, 4096)
            if self.baud is not None and self.line_rate() != self.baud:
                received = bytes(byte ^ 0x5A for byte in received)  # bits at the wrong times
            messages = decoder.feed(received)
            for _ in range(decoder.damaged + decoder.overlong - before):
                self.board.registers.count_error("framing")
            for message in messages:
                if answer := self.board.registers.handle(message):
                    os.write(self._master, self.spoil(serial_frame(answer)))

    def line_rate(self) -> int:
        """Rate to which the driver has set the terminal, in bits per second."""
        code = termios.tcgetattr(self._slave)[5]
        names = [name for name in dir(termios) if re.fullmatch(r"B\d+", name)]
        return next(int(name[1:]) for name in names if getattr(termios, name) == code)

    def close(self) -> None:
        """Unplug."""
        if self._thread.is_alive():
            os.write(self._ends, b"x")
            self._thread.join()
            for descriptor in (self._master, self._slave, self._wake, self._ends):
                os.close(descriptor)


@pytest.fixture
def line() -> Iterator[PtyBoard]:
    """Nine channels, four pulses, on a pseudo terminal."""
    line = PtyBoard(SoftwareIlluminator())
    yield line
    line.close()
