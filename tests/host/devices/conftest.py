# SPDX-License-Identifier: Apache-2.0
"""A board in software behind a pseudo terminal: what a serial port is, without the wire."""

from __future__ import annotations

import os
import select
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

    def state(self, field: str) -> int:
        return self.registers.registers["state"].decode(self.registers.get("state"))[field]

    def _refuses(self, register: Register, indices: tuple[int, ...], word: int) -> bool:
        used = register.name in ("pulse", "bank_period", "bank_enable") and (
            indices[0] == self.registers.get("bank_select")
        )
        return used and bool(self.state("armed"))

    def _wrote(self, register: Register, indices: tuple[int, ...], word: int) -> None:
        file = self.registers
        match register.name:
            case "arm":
                file.set("state", armed=int(word == ARM_KEY and file.get("watchdog_ms") > 0))
            case "sequencer_control" if word & 3:
                file.set("state", sequencing=word & 1)
            case "trigger_now":
                for name in ("triggers_seen", "triggers_served"):
                    file.set(name, value=file.get(name) + 1)
            case "clear" if word & 1:
                for name in ("triggers_seen", "triggers_served", "triggers_ignored"):
                    file.set(name, value=0)


class PtyBoard:
    """Answers on a pseudo terminal until closed.

    Attributes
    ----------
    path : what a driver opens.
    spoil : done to every frame that is sent; by default nothing.
    """

    def __init__(self, board: SoftwareIlluminator) -> None:
        self.board = board
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
            messages = decoder.feed(os.read(self._master, 4096))
            for _ in range(decoder.damaged + decoder.overlong - before):
                self.board.registers.count_error("framing")
            for message in messages:
                if answer := self.board.registers.handle(message):
                    os.write(self._master, self.spoil(serial_frame(answer)))

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
