"""A board behind the control protocol: registers by name, every request answered or timed out."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from itertools import count

from hueflight.devices.errors import (
    DeviceTimeoutError,
    RequestError,
    WrongDeviceError,
)
from hueflight.devices.transports.interface import Transport
from hueflight_protocol import (
    Access,
    MessageError,
    Register,
    RegisterMap,
    Request,
    Response,
    Result,
    decode_response,
    encode_request,
)
from hueflight_protocol.control import CONTROL_VERSION, MAX_WORDS, identify, read, write

_WORD_BITS = 32
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
    board : its four letters, ``HCAM`` or ``HILL``.
    serial : number of the board, 16 hexadecimal digits.
    firmware : version of the gateware, ``major.minor.patch``.
    clock_hz : device clock.
    place : where it is plugged in.
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
    transport : carries the messages.
    registers : map that both sides were built from; compared by fingerprint in `identify`.
    timeout_s : longest wait for one answer.
    attempts : how often a request that may be repeated is sent before giving up.
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
        self._timeout_s = timeout_s
        self._attempts = attempts
        self._numbers = count(1)
        self._lock = threading.Lock()

    def identify(self, letters: bytes, /) -> BoardIdentity:
        """Who is there; the map's fingerprint is checked by `check_map`.

        Raises
        ------
        WrongDeviceError
            If it is another board or speaks another protocol version.
        DeviceTimeoutError
            If nobody answers.
        """
        words = self._exchange(identify(self._number()), repeat=True).payload
        values = self._decode_block(words)
        found = int(values["board"]["value"]).to_bytes(4, "little")
        if found != letters:
            raise WrongDeviceError(
                f"{self.transport.name} answers as board {found!r}, not {letters.decode()!r}: "
                "another board is plugged in there"
            )
        version = values["versions"]
        if version["protocol"] != CONTROL_VERSION:
            raise WrongDeviceError(
                f"the board at {self.transport.name} speaks control protocol "
                f"{version['protocol']}, this host {CONTROL_VERSION}: update the older one"
            )
        return BoardIdentity(
            board=found.decode("ascii"),
            serial=f"{values['serial']['value']:016X}",
            firmware=f"{version['major']}.{version['minor']}.{version['patch']}",
            clock_hz=values["clock_hz"]["value"],
            place=self.transport.name,
        )

    def check_map(self) -> None:
        """Compare the register map's fingerprint with the board's.

        Raises
        ------
        WrongDeviceError
            If the board was built from another map.
        """
        told = self.read("map")
        if told != self.registers.fingerprint:
            raise WrongDeviceError(
                f"the board at {self.transport.name} has register map {told:#010x}, this host "
                f"{self.registers.fingerprint:#010x}: they were built from different versions; "
                "load the gateware that belongs to this host version"
            )

    def read(self, name: str, /, *indices: int) -> int:
        """Whole value of a register, its two words together where it has two."""
        register = self.registers[name]
        words = self.read_words(register.address_of(*indices), register.words)
        return sum(word << _WORD_BITS * i for i, word in enumerate(words))

    def fields(self, name: str, /, *indices: int) -> dict[str, int]:
        """Fields of a register by name."""
        return self.registers[name].decode(self.read(name, *indices))

    def read_words(self, address: int, words: int, /) -> tuple[int, ...]:
        """Words from consecutive addresses, in one request for each 64 of them."""
        found: list[int] = []
        while len(found) < words:
            part = min(MAX_WORDS, words - len(found))
            request = read(self._number(), address + len(found), part)
            found += self._exchange(request, repeat=True).payload
        return tuple(found)

    def write(self, name: str, /, *indices: int, **fields: int) -> None:
        """Set a register; fields not given take their reset value.

        Raises
        ------
        RegisterError
            If a field is unknown or its value does not fit.
        RequestError
            If the board refuses.
        """
        register = self.registers[name]
        self._write(register, register.address_of(*indices), (register.encode(**fields),))

    def write_elements(self, name: str, values: list[int], /) -> None:
        """Write the elements of a one-dimensional array, in requests of 64 words."""
        register = self.registers[name]
        for start in range(0, len(values), MAX_WORDS):
            part = tuple(values[start : start + MAX_WORDS])
            self._write(register, register.address_of(start), part)

    def request(self, request: Request, /, *, repeat: bool = False) -> Response:
        """Send a request of any kind; `repeat` where doing it twice is as good as once."""
        return self._exchange(request, repeat=repeat)

    def close(self) -> None:
        """Give the transport back."""
        self.transport.close()

    def _write(self, register: Register, address: int, words: tuple[int, ...]) -> None:
        repeat = register.access in _REPEATABLE
        self._exchange(write(self._number(), address, words), repeat=repeat)

    def _number(self) -> int:
        return next(self._numbers) & 0xFFFF

    def _exchange(self, request: Request, *, repeat: bool) -> Response:
        message = encode_request(request)
        attempts = self._attempts if repeat else 1
        with self._lock:
            for _ in range(attempts):
                self.transport.send(message)
                response = self._answer(request)
                if response is not None:
                    self._check(request, response)
                    return response
        raise DeviceTimeoutError(
            f"{self.transport.name} did not answer {self._words(request)} within "
            f"{self._timeout_s} s, asked {attempts} times: is the board powered and its gateware "
            "loaded?"
        )

    def _answer(self, request: Request) -> Response | None:
        """The response that belongs to the request; late answers to earlier ones are dropped."""
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
            f"{self.transport.name} answered {name} to {self._words(request)}"
            + (f": {advice}" if advice else "")
        )

    def _words(self, request: Request) -> str:
        """The request as people say it."""
        names = {1: "IDENTIFY", 2: "STATUS", 3: "READ", 4: "WRITE"}
        said = names.get(request.op, f"op {request.op}")
        if request.address in self.registers and request.op in (3, 4):
            said += f" of register {self.registers.at(request.address).register.name!r}"
        return said

    def _decode_block(self, words: tuple[int, ...]) -> dict[str, dict[str, int]]:
        """Registers of the identity block, which begins at address 0."""
        found: dict[str, dict[str, int]] = {}
        for address in range(len(words)):
            place = self.registers.at(address)
            if place.word:
                continue
            register = place.register
            value = sum(words[address + i] << _WORD_BITS * i for i in range(register.words))
            found[register.name] = register.decode(value)
        return found
