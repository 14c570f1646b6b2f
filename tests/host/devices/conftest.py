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

from hueflight.devices.camera import Camera
from hueflight.devices.transports.stream import Stream
from hueflight.emulation.simulated_transport import SimulatedTransport
from hueflight_protocol import (
    CobsDecoder,
    Register,
    RegisterFile,
    camera_map,
    illuminator_map,
    serial_frame,
)
from hueflight_protocol.control import MAX_COBS_BYTES
from hueflight_protocol.illuminator_map import ARM_KEY

Spoil = Callable[[bytes], bytes]


class SoftwareClock:
    """The choice of a board's clock in its registers, as far as a driver sees."""

    def __init__(self, registers: RegisterFile) -> None:
        self.registers = registers
        self.dies_on_change = False

    def connect_clock(self, present: bool) -> None:
        """Connect an external clock, or take it away: the board then uses its own."""
        state = self.registers.registers["clock_state"].decode(self.registers.get("clock_state"))
        lost = int((not present and state["external"]) or state["lost"])
        self.registers.set("clock_state", present=int(present), external=0, lost=lost)
        if lost:
            self.registers.set("faults", clock_failed=1, reference_lost=1)
            self.pause()

    def change_clock(self, word: int) -> None:
        """Do what a write to ``clock_source`` does."""
        state = self.registers.registers["clock_state"].decode(self.registers.get("clock_state"))
        wanted = word & state["present"]
        if wanted != state["external"] and not self.dies_on_change:
            self.registers.set("clock_state", external=wanted, lost=0)
            self.registers.set("faults", clock_failed=1)
            self.pause()

    def pause(self) -> None:
        """Do what a failure of the clock does."""


class SoftwareCamera(SoftwareClock):
    """Registers of a camera with an external clock, as far as a driver sees."""

    def __init__(self) -> None:
        registers = camera_map(external_clock=True, reference_hz=10_000_000)
        super().__init__(RegisterFile(registers, on_write=self._wrote))
        self.edges: list[SoftwareCamera] = []

    def camera(self) -> Camera:
        """Open a driver."""

        def open_stream(size: int) -> Stream:
            raise AssertionError("it sends no packets")

        return Camera(SimulatedTransport(self.registers.handle, "test line"), open_stream)

    def pause(self) -> None:
        """End the run and the common time."""
        self.registers.set("state", running=0)
        self.registers.set("time_state", armed=0, done=0)

    def edge(self) -> None:
        """Get an edge at the input."""
        state = self.registers.registers["time_state"].decode(self.registers.get("time_state"))
        if state["armed"]:
            self.registers.set("time_state", armed=0, done=1)

    def _wrote(self, register: Register, indices: tuple[int, ...], word: int) -> None:
        match register.name:
            case "clock_source":
                self.change_clock(word)
            case "run":
                self.registers.set("state", running=word & 1)
            case "time_sync" if word & 1:
                self.registers.set("time_state", armed=1, done=0)
            case "time_sync" if word & 2:
                for camera in self.edges:
                    camera.edge()


class SoftwareIlluminator(SoftwareClock):
    """Registers that act as the gateware's do, as far as a driver sees."""

    def __init__(self, **size: int) -> None:
        super().__init__(
            RegisterFile(illuminator_map(**size), on_write=self._wrote, refuses=self._refuses)
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
                self.change_clock(word)
            case "sequencer_control" if word & 3:
                file.set("state", sequencing=word & 1)
            case "trigger_now":
                for name in ("triggers_seen", "triggers_served"):
                    file.set(name, value=file.get(name) + 1)
            case "clear" if word & 1:
                for name in ("triggers_seen", "triggers_served", "triggers_ignored"):
                    file.set(name, value=0)

    def pause(self) -> None:
        """Disarm the board."""
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
