# SPDX-License-Identifier: Apache-2.0
"""The register file in software: answers control messages exactly as the gateware must.

It is the reference for the gateware's register file, and answers for every simulated board.
"""

from collections.abc import Callable
from typing import TypeVar

from .control import (
    CONTROL_VERSION,
    IDENTITY_ADDRESS,
    IDENTITY_WORDS,
    MAX_WORDS,
    STATUS_ADDRESS,
    STATUS_WORDS,
    Op,
    Request,
    Response,
    Result,
    decode_request,
    encode_response,
)
from .errors import MessageError
from .register_value import RegisterValue
from .registers import WORD_BITS, Access, Place, Register, RegisterMap

_WORD = (1 << WORD_BITS) - 1

R = TypeVar("R", bound=RegisterValue)

WriteHook = Callable[[Register, tuple[int, ...], int], None]
RefuseHook = Callable[[Register, tuple[int, ...], int], bool]


class RegisterFile:
    """A board's registers, and the answers to requests about them.

    Parameters
    ----------
    registers : RegisterMap
        Of the board.
    on_write : callable, optional
        Called with register, indices and word after each word that a request wrote; this is
        where a simulated board acts on PULSE and KEY registers.
    refuses : callable, optional
        Called with register, indices and word before anything is written; true answers
        `Result.REFUSED`.
    """

    def __init__(
        self,
        registers: RegisterMap,
        /,
        *,
        on_write: WriteHook | None = None,
        refuses: RefuseHook | None = None,
    ) -> None:
        self.registers = registers
        self._on_write = on_write
        self._refuses = refuses
        self._values = {
            (register.name, indices): register.reset
            for register in registers
            for indices in register.elements()
        }
        self._held: dict[str, int] = {}  # 64-bit values as they were when last read
        self.set("map", value=registers.fingerprint)

    def get(self, name: str, /, *indices: int) -> int:
        """Return the whole value of a register.

        Parameters
        ----------
        name : str
            Name of the register.
        *indices : int
            Element of an array.

        Returns
        -------
        int
            The value.
        """
        if (name, indices) not in self._values:
            self.registers[name].address_of(*indices)  # says what is wrong
        return self._values[name, indices]

    def set(self, name: str, /, *indices: int, **fields: int) -> None:
        """Set fields of a register from the hardware's side; the others keep their value.

        Parameters
        ----------
        name : str
            Name of the register.
        *indices : int
            Element of an array.
        **fields : int
            New values by the name of the field.
        """
        register = self.registers[name]
        fields = register.decode(self.get(name, *indices)) | fields
        self._values[name, indices] = register.encode(**fields)

    def load(self, register: type[R], /, *indices: int) -> R:
        """Return the value of a register by its type.

        Parameters
        ----------
        register : type of RegisterValue
            Type of the register, from `typed_registers`.
        *indices : int
            Element of an array.

        Returns
        -------
        RegisterValue
            The fields.
        """
        return register.decode(self.registers[register.NAME], self.get(register.NAME, *indices))

    def store(self, value: RegisterValue, /, *indices: int) -> None:
        """Set all fields of a register from the hardware's side.

        Parameters
        ----------
        value : RegisterValue
            The register with its fields.
        *indices : int
            Element of an array.
        """
        register = self.registers[value.NAME]
        register.address_of(*indices)  # says what is wrong
        self._values[value.NAME, indices] = value.encode(register)

    def handle(self, message: bytes, /) -> bytes | None:
        """Answer a control message.

        Parameters
        ----------
        message : bytes
            A control message.

        Returns
        -------
        bytes or None
            The answer; None for a message that is dropped and counted.
        """
        try:
            request = decode_request(message)
        except MessageError as error:
            self.count_error("crc" if error.rule == "C4" else "framing")
            return None
        response = self.answer(request)
        self._count("requests", "value")
        return encode_response(response)

    def count_error(self, field: str, /) -> None:
        """Count a message that was dropped.

        Parameters
        ----------
        field : str
            ``"crc"``, or ``"framing"`` for lengths and COBS.
        """
        self._count("request_errors", field)

    def answer(self, request: Request, /) -> Response:
        """Do what a well-formed request asks.

        Parameters
        ----------
        request : Request
            The request.

        Returns
        -------
        Response
            The answer.
        """
        address, count = request.address, request.count
        if request.op == Op.IDENTIFY:
            address, count = IDENTITY_ADDRESS, IDENTITY_WORDS
        elif request.op == Op.STATUS:
            address, count = STATUS_ADDRESS, STATUS_WORDS
        result = self._judge(request, address, count)
        payload: tuple[int, ...] = ()
        if result == Result.OK and request.op == Op.WRITE:
            for place, word in zip(self._places(address, count), request.payload, strict=True):
                self._write(place, word)
        elif result == Result.OK:
            payload = tuple(self._read(place) for place in self._places(address, count))
        return Response(request.transaction, request.op & 0x7F, request.address, result, payload)

    def _judge(self, request: Request, address: int, count: int) -> Result:
        """Return the first of the results, in the order of their numbers, that applies."""
        writing = request.op == Op.WRITE
        if request.version != CONTROL_VERSION:
            return Result.BAD_VERSION
        if request.op not in list(Op):
            return Result.BAD_OP
        if len(request.payload) != (count if writing else 0) or not 1 <= count <= MAX_WORDS:
            return Result.BAD_COUNT
        if any(a not in self.registers for a in range(address, address + count)):
            return Result.BAD_ADDRESS
        if not writing:
            return Result.OK
        places = self._places(address, count)
        if not all(place.register.access.writable for place in places):
            return Result.READ_ONLY
        if self._refuses is not None and any(
            self._refuses(place.register, place.indices, word)
            for place, word in zip(places, request.payload, strict=True)
        ):
            return Result.REFUSED
        return Result.OK

    def _places(self, address: int, count: int) -> list[Place]:
        return [self.registers.at(a) for a in range(address, address + count)]

    def _read(self, place: Place) -> int:
        register = place.register
        if register.access in (Access.PULSE, Access.KEY):
            return 0
        value = self._values[register.name, place.indices]
        if place.word == 0:
            self._held[register.name] = value
        else:
            value = self._held.get(register.name, 0)
        return value >> WORD_BITS * place.word & _WORD

    def _write(self, place: Place, word: int) -> None:
        register, key = place.register, (place.register.name, place.indices)
        word &= register.mask
        if register.access == Access.RW:
            self._values[key] = word
        elif register.access == Access.W1C:
            self._values[key] &= ~word
        if self._on_write is not None:
            self._on_write(register, place.indices, word)

    def _count(self, name: str, field: str) -> None:
        register = self.registers[name]
        present = register.decode(self.get(name))[field]
        if present < register.fields[field].field.maximum:
            self.set(name, **{field: present + 1})
