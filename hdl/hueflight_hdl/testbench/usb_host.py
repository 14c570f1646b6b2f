# SPDX-License-Identifier: Apache-2.0
"""A model of a USB host: reset, enumeration, bulk transfers and transmission errors.

The host sees the bus as UTMI shows it, byte for byte, and knows nothing of the gateware.

# Ref: Universal Serial Bus Specification 2.0, chapters 7.1.7.5 (reset), 8 (packets), 9 (requests).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from .cxxrtl import Simulation, SimulationError

IDLE_J, SE0, CHIRP_K, CHIRP_J = 0b01, 0b00, 0b10, 0b01
ANSWER_CLOCKS = 60
"""A high-speed device has 192 bit times to begin its answer: 24 clocks; some for pipelines."""
LONGEST_CLOCKS = 600
MICROSECOND = 60
_TRIES = 2000


class Pid(IntEnum):
    """Packet identifiers."""

    OUT = 0b0001
    IN = 0b1001
    SOF = 0b0101
    SETUP = 0b1101
    DATA0 = 0b0011
    DATA1 = 0b1011
    ACK = 0b0010
    NAK = 0b1010
    STALL = 0b1110


@dataclass
class BusErrors:
    """Rates of transmission errors on the bus.

    Parameters
    ----------
    rng : numpy.random.Generator
    damaged : float
        Share of the host's data packets of which a bit flips.
    unheard : float
        Share of the host's acknowledgements that the device does not get.
    """

    rng: np.random.Generator
    damaged: float = 0.0
    unheard: float = 0.0


class UsbHost:
    """A host with one device on its bus.

    Parameters
    ----------
    simulation : Simulation
        Of a `UsbCameraTestbench`.
    per_clock : int
        Clocks of the simulation in one of `usb`.
    errors : BusErrors, optional
        By default nothing goes wrong.

    Attributes
    ----------
    address : int
        Of the device.
    retries : int
        Transactions that had to be repeated because something went wrong on the bus.
    waits : int
        Transactions for which the device was not ready.
    """

    def __init__(
        self, simulation: Simulation, *, per_clock: int, errors: BusErrors | None = None
    ) -> None:
        self.address = 0
        self.retries = 0
        self.waits = 0
        self.errors = errors
        self._simulation = simulation
        self._per_clock = per_clock
        self._line = IDLE_J
        self._toggles: dict[tuple[int, bool], int] = {}

    # -- the wire -------------------------------------------------------------------------------

    def wait(self, clocks: int, /, *, line: int | None = None) -> NDArray:
        """Let so many clocks of `usb` pass; return the outputs in each."""
        inputs = self._simulation.inputs(1)
        inputs["line_state"] = self._line if line is None else line
        inputs["tx_ready"] = 1
        return self._simulation.run(inputs, hold=clocks * self._per_clock)[:: self._per_clock]

    def send(self, content: bytes, /) -> None:
        """Send a packet."""
        inputs = self._simulation.inputs(len(content) + 3)
        inputs["line_state"] = self._line
        inputs["rx_active"][:-1] = 1
        inputs["line_state"][:-1] = IDLE_J
        inputs["rx_valid"][1:-2] = 1
        inputs["rx_data"][1:-2] = np.frombuffer(content, np.uint8)
        inputs["rx_active"][-2:] = 0
        self._simulation.run(np.repeat(inputs, self._per_clock))

    def receive(self) -> bytes | None:
        """Return the packet that comes within the time that a device has, or None."""
        outputs = self.wait(ANSWER_CLOCKS)
        valid = outputs["tx_valid"]
        if not valid.any():
            return None
        parts = [outputs["tx_data"][valid == 1]]
        waited = 0
        while valid[-1]:
            outputs = self.wait(ANSWER_CLOCKS)
            valid = outputs["tx_valid"]
            parts.append(outputs["tx_data"][valid == 1])
            waited += ANSWER_CLOCKS
            if waited > LONGEST_CLOCKS:
                raise SimulationError("the device sends without end")
        return np.concatenate(parts).astype(np.uint8).tobytes()

    # -- reset and speed ------------------------------------------------------------------------

    def reset(self) -> bool:
        """Reset the bus and answer the device's chirp; return whether it went to high speed."""
        self.wait(10 * MICROSECOND)
        self.address = 0
        self._toggles.clear()
        chirped = 0
        for _ in range(40):
            outputs = self.wait(100 * MICROSECOND, line=SE0)
            chirping = (outputs["tx_valid"] & outputs["chirp"]) == 1
            chirped += int(chirping.sum())
            if chirped and not chirping[-1]:
                break
        if chirped < 1000 * MICROSECOND:  # 7.1.7.5: at least a millisecond
            return False
        for _ in range(4):
            self.wait(50 * MICROSECOND, line=CHIRP_K)
            self.wait(50 * MICROSECOND, line=CHIRP_J)
        self._line = SE0
        return bool(self.wait(10 * MICROSECOND)["high_speed"][-1])

    # -- transactions ---------------------------------------------------------------------------

    def _token(self, pid: Pid, endpoint: int) -> None:
        self.send(token(pid, self.address, endpoint))

    def _next_toggle(self, endpoint: int, *, inward: bool) -> Pid:
        return (Pid.DATA0, Pid.DATA1)[self._toggles.get((endpoint, inward), 0)]

    def _flip(self, endpoint: int, *, inward: bool) -> None:
        self._toggles[endpoint, inward] = 1 - self._toggles.get((endpoint, inward), 0)

    def read_packet(self, endpoint: int, /, *, tries: int = 1) -> bytes | None:
        """Ask an endpoint for a data packet; None if it has none."""
        for _ in range(tries):
            self._token(Pid.IN, endpoint)
            answer = self.receive()
            if answer is None:
                raise SimulationError(f"endpoint {endpoint} did not answer IN")
            pid = _pid(answer)
            if pid == Pid.NAK:
                self.waits += 1
                continue
            if pid not in (Pid.DATA0, Pid.DATA1):
                raise SimulationError(f"endpoint {endpoint} answered IN with {pid.name}")
            content = answer[1:-2]
            if crc16(content).to_bytes(2, "little") != answer[-2:]:
                raise SimulationError(f"endpoint {endpoint} sent a data packet with a wrong CRC")
            lost = self.errors is not None and self.errors.rng.random() < self.errors.unheard
            if lost:
                self.retries += 1
            else:
                self.send(handshake(Pid.ACK))
            fresh = pid == self._next_toggle(endpoint, inward=True)
            # what comes twice was acknowledged before, but the device did not hear it
            if fresh:
                self._flip(endpoint, inward=True)
                return content
        return None

    def write_packet(self, endpoint: int, content: bytes, /, *, token_pid: Pid = Pid.OUT) -> None:
        """Send a data packet to an endpoint, again and again until it is taken."""
        packet = data_packet(self._next_toggle(endpoint, inward=False), content)
        for _ in range(_TRIES):
            self._token(token_pid, endpoint)
            damaged = self.errors is not None and self.errors.rng.random() < self.errors.damaged
            self.send(_damage(packet, self.errors.rng) if damaged and self.errors else packet)
            answer = self.receive()
            if damaged:
                if answer is not None:
                    raise SimulationError(f"a damaged packet was answered: {answer.hex(' ')}")
                self.retries += 1
            elif answer is None:
                raise SimulationError(f"endpoint {endpoint} did not answer {token_pid.name}")
            elif _pid(answer) == Pid.ACK:
                self._flip(endpoint, inward=False)
                return
            elif _pid(answer) != Pid.NAK:
                raise SimulationError(f"endpoint {endpoint} answered {_pid(answer).name}")
            else:
                self.waits += 1
        raise SimulationError(f"endpoint {endpoint} took nothing in {_TRIES} tries")

    # -- control transfers ----------------------------------------------------------------------

    def control_in(self, request: int, value: int, length: int, /, *, index: int = 0) -> bytes:
        """Make a standard request that is answered with data."""
        self._setup(0x80, request, value, index, length)
        self._toggles[0, True] = 1
        content = b""
        while len(content) < length:
            packet = self.read_packet(0, tries=_TRIES)
            if packet is None:
                raise SimulationError(f"request {request} was not answered")
            content += packet
            if len(packet) < 64:
                break
        self._toggles[0, False] = 1
        self.write_packet(0, b"")
        return content

    def control_out(self, request: int, value: int, /) -> None:
        """Make a standard request without data."""
        self._setup(0, request, value, 0, 0)
        self._toggles[0, True] = 1
        if self.read_packet(0, tries=_TRIES) != b"":
            raise SimulationError(f"request {request} was not confirmed")

    def _setup(self, kind: int, request: int, value: int, index: int, length: int) -> None:
        self._toggles[0, False] = 0
        content = bytes([kind, request])
        content += b"".join(number.to_bytes(2, "little") for number in (value, index, length))
        self.write_packet(0, content, token_pid=Pid.SETUP)

    # -- bulk transfers -------------------------------------------------------------------------

    def read(self, endpoint: int, /, *, packet_bytes: int = 512, tries: int = 1000) -> bytes:
        """Read a transfer: packets up to a short one, or until there is none for so many tries."""
        content = b""
        while True:
            packet = self.read_packet(endpoint, tries=tries)
            if packet is None:
                return content
            content += packet
            if len(packet) < packet_bytes:
                return content


def token(pid: Pid, address: int, endpoint: int, /) -> bytes:
    """Return a token packet."""
    value = address | endpoint << 7
    return bytes([_pid_byte(pid)]) + (value | crc5(value) << 11).to_bytes(2, "little")


def data_packet(pid: Pid, content: bytes, /) -> bytes:
    """Return a data packet."""
    return bytes([_pid_byte(pid)]) + content + crc16(content).to_bytes(2, "little")


def handshake(pid: Pid, /) -> bytes:
    """Return a handshake packet."""
    return bytes([_pid_byte(pid)])


def crc5(value: int, /, *, bits: int = 11) -> int:
    """Return the CRC of a token's eleven bits."""
    return _crc(((value >> bit & 1) for bit in range(bits)), 0x14, 0x1F)


def crc16(content: bytes, /) -> int:
    """Return the CRC of a data packet's content."""
    return _crc((byte >> bit & 1 for byte in content for bit in range(8)), 0xA001, 0xFFFF)


def _crc(bits: object, polynomial: int, ones: int) -> int:
    crc = ones
    for bit in bits:
        crc = crc >> 1 ^ (polynomial if (crc ^ bit) & 1 else 0)
    return crc ^ ones


def _pid_byte(pid: Pid) -> int:
    return pid | (pid ^ 0xF) << 4


def _pid(packet: bytes) -> Pid:
    if packet[0] >> 4 ^ 0xF != packet[0] & 0xF:
        raise SimulationError(f"a packet identifier without its complement: {packet[0]:#04x}")
    return Pid(packet[0] & 0xF)


def _damage(packet: bytes, rng: np.random.Generator) -> bytes:
    """Flip a bit behind the packet's identifier."""
    broken = bytearray(packet)
    broken[rng.integers(1, len(packet))] ^= 1 << rng.integers(8)
    return bytes(broken)
