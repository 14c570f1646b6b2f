# SPDX-License-Identifier: Apache-2.0
"""A board behind the control protocol: typed registers, every request answered or timed out."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from itertools import count
from typing import TypeVar, overload

from hueflight.devices.errors import (
    DeviceTimeoutError,
    RequestError,
    WrongDeviceError,
)
from hueflight.devices.transports.interface import Transport
from hueflight_protocol import (
    Access,
    MessageError,
    Op,
    Register,
    RegisterMap,
    RegisterValue,
    Request,
    Response,
    Result,
    decode_response,
    encode_request,
)
from hueflight_protocol.control import (
    CONTROL_VERSION,
    IDENTITY_ADDRESS,
    MAX_TRANSACTION,
    MAX_WORDS,
    identify,
    read,
    write,
)
from hueflight_protocol.registers import WORD_BITS
from hueflight_protocol.typed_registers import common

R = TypeVar("R", bound=RegisterValue)
A = TypeVar("A", bound=RegisterValue)
B = TypeVar("B", bound=RegisterValue)
C = TypeVar("C", bound=RegisterValue)

_REPEATABLE = (Access.CONST, Access.RO, Access.RW)  # doing it twice is as good as once
_ADVICE = {
    Result.BAD_VERSION: "update the older of gateware and host",
    Result.BAD_ADDRESS: "this gateware lacks the register; update it",
    Result.REFUSED: "the board's state does not allow it now",
}


@dataclass(frozen=True)
class BoardIdentity:
    """What a board says it is.

    Attributes
    ----------
    board : str
        Its four letters, ``HCAM`` or ``HILL``.
    serial : str
        Serial number of the board, 16 hexadecimal digits.
    firmware : str
        Version of the gateware, ``major.minor.patch``.
    clock_hz : int
        Frequency of the device clock in hertz.
    place : str
        Where the board is plugged in, such as ``USB 001:004``.
    """

    board: str
    serial: str
    firmware: str
    clock_hz: int
    place: str


class Board:
    """Registers of a board over a transport; safe to use from several threads.

    Parameters
    ----------
    transport : Transport
        Carries the messages.
    registers : RegisterMap
        Map that both sides were built from; `check_map` compares fingerprints.
    timeout_s : float
        Longest time to wait for one answer, in seconds.
    attempts : int
        Number of times that a request which may be repeated is sent before giving up.

    Attributes
    ----------
    repeated : int
        Times that a request was sent again because no whole answer had come.
    """

    def __init__(
        self,
        transport: Transport,
        registers: RegisterMap,
        /,
        *,
        timeout_s: float = 0.5,
        attempts: int = 3,
    ) -> None:
        self.transport = transport
        self.registers = registers
        self.repeated = 0
        self._timeout_s = timeout_s
        self._attempts = attempts
        self._numbers = count(1)
        self._lock = threading.Lock()

    def identify(self, letters: bytes, /) -> BoardIdentity:
        """Ask the board what it is; `check_map` compares the register maps.

        Parameters
        ----------
        letters : bytes
            Four letters of the kind of board that is expected.

        Returns
        -------
        BoardIdentity
            Kind, serial number, version and clock.

        Raises
        ------
        WrongDeviceError
            If it is another board or speaks another protocol version.
        DeviceTimeoutError
            If nobody answers.
        """
        words = self._exchange(identify(self._number()), repeat=True).payload

        def value(register: type[R]) -> R:
            return self._decode(register, words, first=IDENTITY_ADDRESS)

        found = value(common.Board).value.to_bytes(4, "little")
        if found != letters:
            raise WrongDeviceError(
                f"{self.transport.name} answers as board {found!r}, not {letters.decode()!r}: "
                "another board is plugged in there"
            )
        versions = value(common.Versions)
        if versions.protocol != CONTROL_VERSION:
            raise WrongDeviceError(
                f"the board at {self.transport.name} speaks control protocol "
                f"{versions.protocol}, this host {CONTROL_VERSION}: update the older one"
            )
        return BoardIdentity(
            board=found.decode("ascii"),
            serial=f"{value(common.Serial).value:016X}",
            firmware=f"{versions.major}.{versions.minor}.{versions.patch}",
            clock_hz=value(common.ClockHz).value,
            place=self.transport.name,
        )

    def check_map(self) -> None:
        """Compare the register map's fingerprint with the board's.

        Raises
        ------
        WrongDeviceError
            If the board was built from another map.
        """
        told = self.read(common.Map).value
        if told != self.registers.fingerprint:
            raise WrongDeviceError(
                f"the board at {self.transport.name} has register map {told:#010x}, this host "
                f"{self.registers.fingerprint:#010x}: they were built from different versions; "
                "load the gateware that belongs to this host version"
            )

    def read(self, register: type[R], /, *indices: int) -> R:
        """Read a register.

        Parameters
        ----------
        register : type of RegisterValue
            Type of the register.
        *indices : int
            Element of an array of registers.

        Returns
        -------
        RegisterValue
            The fields.
        """
        declared = self.registers[register.NAME]
        first = declared.address_of(*indices)
        words = self.read_words(first, declared.words)
        return register.decode(declared, _joined(words))

    @overload
    def read_together(self, first: type[A], second: type[B], /) -> tuple[A, B]: ...

    @overload
    def read_together(
        self, first: type[A], second: type[B], third: type[C], /
    ) -> tuple[A, B, C]: ...

    @overload
    def read_together(self, *registers: type[R]) -> tuple[R, ...]: ...

    def read_together(self, *registers: type[RegisterValue]) -> tuple[RegisterValue, ...]:
        """Read registers that follow one another in one request, so that they belong together.

        Parameters
        ----------
        *registers : type of RegisterValue
            Types of the registers, from the lowest address up.

        Returns
        -------
        tuple of RegisterValue
            Their fields.
        """
        declared = [self.registers[register.NAME] for register in registers]
        first = declared[0].address
        words = self.read_words(first, declared[-1].address + declared[-1].words - first)
        return tuple(self._decode(register, words, first=first) for register in registers)

    def read_elements(self, register: type[RegisterValue], /) -> tuple[int, ...]:
        """Read all elements of a one-dimensional array of registers.

        Parameters
        ----------
        register : type of RegisterValue
            Type of the register.

        Returns
        -------
        tuple of int
            The words.
        """
        declared = self.registers[register.NAME]
        return self.read_words(declared.address, declared.count[0])

    def read_words(self, address: int, words: int, /) -> tuple[int, ...]:
        """Read consecutive words, in one request for each 64 of them.

        Parameters
        ----------
        address : int
            Word address of the first one.
        words : int
            Number of words.

        Returns
        -------
        tuple of int
            The words.
        """
        found: list[int] = []
        while len(found) < words:
            part = min(MAX_WORDS, words - len(found))
            request = read(self._number(), address + len(found), part)
            found += self._exchange(request, repeat=True).payload
        return tuple(found)

    def write(self, value: RegisterValue, /, *indices: int) -> None:
        """Write a register.

        Parameters
        ----------
        value : RegisterValue
            The register with its fields.
        *indices : int
            Element of an array of registers.

        Raises
        ------
        RegisterError
            If a field does not fit its width.
        RequestError
            If the board refuses.
        """
        declared = self.registers[value.NAME]
        self._write(declared, declared.address_of(*indices), (value.encode(declared),))

    def write_elements(self, register: type[RegisterValue], values: list[int], /) -> None:
        """Write the elements of a one-dimensional array of registers, 64 in each request.

        Parameters
        ----------
        register : type of RegisterValue
            Type of the register.
        values : list of int
            Words, from the first element on.
        """
        declared = self.registers[register.NAME]
        for start in range(0, len(values), MAX_WORDS):
            part = tuple(values[start : start + MAX_WORDS])
            self._write(declared, declared.address_of(start), part)

    def request(self, request: Request, /, *, repeat: bool = False) -> Response:
        """Send a request of any kind.

        Parameters
        ----------
        request : Request
            The request, with a transaction number of the caller's.
        repeat : bool
            True if doing it twice is as good as once, so that it may be sent again.

        Returns
        -------
        Response
            The answer, whose result is OK.
        """
        return self._exchange(request, repeat=repeat)

    def close(self) -> None:
        """Release the transport."""
        self.transport.close()

    def _decode(self, register: type[R], words: tuple[int, ...], *, first: int) -> R:
        """Take a register out of words that were read from address `first` on."""
        declared = self.registers[register.NAME]
        start = declared.address - first
        return register.decode(declared, _joined(words[start : start + declared.words]))

    def _write(self, register: Register, address: int, words: tuple[int, ...]) -> None:
        repeat = register.access in _REPEATABLE
        self._exchange(write(self._number(), address, words), repeat=repeat)

    def _number(self) -> int:
        return next(self._numbers) & MAX_TRANSACTION

    def _exchange(self, request: Request, *, repeat: bool) -> Response:
        message = encode_request(request)
        attempts = self._attempts if repeat else 1
        with self._lock:
            for attempt in range(attempts):
                self.repeated += attempt > 0
                self.transport.send(message)
                response = self._answer(request)
                if response is not None:
                    self._check(request, response)
                    return response
        raise DeviceTimeoutError(
            f"{self.transport.name} did not answer {self._described(request)} within "
            f"{self._timeout_s} s, asked {attempts} times: is the board powered and its gateware "
            "loaded?"
        )

    def _answer(self, request: Request) -> Response | None:
        """Return the response to a request; late answers to earlier requests are dropped."""
        deadline = time.monotonic() + self._timeout_s
        while (left := deadline - time.monotonic()) > 0:
            message = self.transport.receive(left)
            if message is None:
                return None
            try:
                response = decode_response(message)
            except MessageError:
                continue  # damaged on the line: the answer that does not come is asked for again
            if (response.transaction, response.op) == (request.transaction, request.op):
                return response
        return None

    def _check(self, request: Request, response: Response) -> None:
        if response.result == Result.OK:
            return
        known = response.result in list(Result)
        name = Result(response.result).name if known else f"result {response.result}"
        advice = _ADVICE.get(Result(response.result)) if known else None
        raise RequestError(
            f"{self.transport.name} answered {name} to {self._described(request)}"
            + (f": {advice}" if advice else "")
        )

    def _described(self, request: Request) -> str:
        """Return what the request asks, in words."""
        said = Op(request.op).name if request.op in list(Op) else f"op {request.op}"
        if request.address in self.registers and request.op in (Op.READ, Op.WRITE):
            said += f" of register {self.registers.at(request.address).register.name!r}"
        return said


def _joined(words: tuple[int, ...]) -> int:
    """Return the value of a register whose words are given, the low word first."""
    return sum(word << WORD_BITS * i for i, word in enumerate(words))
