# SPDX-License-Identifier: Apache-2.0
"""Register maps: declared once, from which gateware and host both derive.

A register is one 32-bit word at a word address; values of 64 bits take two. Fields are given
from the lowest bit up, so that their positions follow from their widths.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from itertools import product

from .checksum import crc32c
from .errors import RegisterError

WORD_BITS = 32
ADDRESS_BITS = 16


class Access(Enum):
    """Who may write a register, and what a write does."""

    CONST = "const"
    """Fixed when the gateware is built."""
    RO = "ro"
    """Set by the gateware; the host reads."""
    RW = "rw"
    """Set by the host; the gateware reads."""
    W1C = "w1c"
    """Set by the gateware and held; the host clears each bit by writing 1 to it."""
    PULSE = "pulse"
    """Each 1 written acts once; reads as 0."""
    KEY = "key"
    """A write acts only with the value that the field's documentation names; reads as 0."""

    @property
    def writable(self) -> bool:
        """Whether a write is answered with OK rather than READ_ONLY."""
        return self not in (Access.CONST, Access.RO)


@dataclass(frozen=True, slots=True)
class Field:
    """Some bits of a register.

    Parameters
    ----------
    name : str
        Lower case.
    width : int
        Bits.
    doc : str
        Meaning.
    reset : int
        Value after reset; of a CONST field, what it is unless the build says otherwise.
    unit : str
        Physical unit, empty for plain numbers.
    signed : bool
        Two's complement.
    choices : type of IntEnum, optional
        Named values.
    """

    name: str
    width: int
    doc: str
    reset: int = 0
    unit: str = ""
    signed: bool = False
    choices: type[IntEnum] | None = None

    @property
    def minimum(self) -> int:
        """Smallest value."""
        return -(1 << self.width - 1) if self.signed else 0

    @property
    def maximum(self) -> int:
        """Largest value."""
        return (1 << self.width - self.signed) - 1


@dataclass(frozen=True, slots=True)
class Reserved:
    """Bits without a meaning: read as 0, ignored in a write.

    Parameters
    ----------
    width : int
        Number of bits.
    """

    width: int


Parts = tuple[Field | Reserved, ...]


@dataclass(frozen=True, slots=True)
class PlacedField:
    """A field and its lowest bit."""

    field: Field
    shift: int


@dataclass(frozen=True)
class Register:
    """One register, or an array of equal ones.

    Parameters
    ----------
    name : str
        Lower case.
    address : int
        Word address of the first element's first word.
    access : Access
        Who may write.
    parts : tuple of Field or Reserved
        From bit 0 up.
    doc : str
        Meaning.
    count : tuple of int
        Elements along each axis of an array; empty for a single register.
    strides : tuple of int
        Words from one element to the next, along each axis.
    words : int
        1, or 2 for a 64-bit value: low word first. The high word is read as it was when the
        low word was read.
    """

    name: str
    address: int
    access: Access
    parts: Parts
    doc: str
    count: tuple[int, ...] = ()
    strides: tuple[int, ...] = ()
    words: int = 1
    fields: Mapping[str, PlacedField] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        placed: dict[str, PlacedField] = {}
        shift = 0
        for part in self.parts:
            if isinstance(part, Field):
                if part.name in placed:
                    raise RegisterError(f"register {self.name}: field {part.name!r} stands twice")
                if not part.minimum <= part.reset <= part.maximum:
                    raise RegisterError(
                        f"{self.name}.{part.name}: {part.reset} does not fit {part.width} bits"
                    )
                placed[part.name] = PlacedField(part, shift)
            shift += part.width
        if shift > WORD_BITS * self.words:
            raise RegisterError(f"register {self.name}: {shift} bits in {self.words} words")
        if len(self.count) != len(self.strides):
            raise RegisterError(
                f"register {self.name}: count {self.count} and strides {self.strides} "
                "must be equally many"
            )
        object.__setattr__(self, "fields", placed)

    @property
    def reset(self) -> int:
        """Value after reset."""
        return self.encode()

    @property
    def mask(self) -> int:
        """Ones at all bits that belong to a field."""
        return sum(((1 << p.field.width) - 1) << p.shift for p in self.fields.values())

    def address_of(self, *indices: int) -> int:
        """Return the word address of an element's first word.

        Parameters
        ----------
        *indices : int
            Element of an array; none for a single register.

        Returns
        -------
        int
            The address.

        Raises
        ------
        RegisterError
            If there are too many or too few indices, or one is out of range.
        """
        if len(indices) != len(self.count):
            raise RegisterError(f"{self.name} takes {len(self.count)} indices, got {indices}")
        for index, count in zip(indices, self.count, strict=True):
            if not 0 <= index < count:
                raise RegisterError(
                    f"{self.name}{list(indices)}: index {index} is not below {count}"
                )
        return self.address + sum(i * s for i, s in zip(indices, self.strides, strict=True))

    def elements(self) -> Iterator[tuple[int, ...]]:
        """Return the indices of every element.

        Returns
        -------
        iterator of tuple of int
            Indices; one empty tuple for a single register.
        """
        return product(*(range(count) for count in self.count))

    def encode(self, **values: int) -> int:
        """Return the register's value; fields not given take their reset value.

        Parameters
        ----------
        **values : int
            Values by the name of the field.

        Returns
        -------
        int
            The value.

        Raises
        ------
        RegisterError
            If a field is unknown or its value does not fit.
        """
        for name in values:
            if name not in self.fields:
                known = ", ".join(self.fields)
                raise RegisterError(f"{self.name} has no field {name!r}; it has {known}")
        word = 0
        for name, place in self.fields.items():
            part = place.field
            value = values.get(name, part.reset)
            if not part.minimum <= value <= part.maximum:
                raise RegisterError(
                    f"{self.name}.{name} = {value}: must be from {part.minimum} to {part.maximum}"
                )
            word |= (value & (1 << part.width) - 1) << place.shift
        return word

    def decode(self, value: int, /) -> dict[str, int]:
        """Take a value apart.

        Parameters
        ----------
        value : int
            Value of the register.

        Returns
        -------
        dict of str to int
            Fields by name; named choices as members of their enumeration.
        """
        out: dict[str, int] = {}
        for name, place in self.fields.items():
            part = place.field
            bits = value >> place.shift & (1 << part.width) - 1
            if part.signed and bits >> part.width - 1:
                bits -= 1 << part.width
            if part.choices is not None and bits in list(part.choices):
                bits = part.choices(bits)
            out[name] = bits
        return out


def value(width: int, doc: str, *, reset: int = 0, unit: str = "") -> tuple[Field]:
    """Return the parts of a register that is one field, called ``value``."""
    return (Field("value", width, doc, reset=reset, unit=unit),)


@dataclass(frozen=True, slots=True)
class Place:
    """What stands at one word address.

    Parameters
    ----------
    register : Register
        The register.
    indices : tuple of int
        Element of an array.
    word : int
        Which of the register's words.
    """

    register: Register
    indices: tuple[int, ...]
    word: int


class RegisterMap:
    """All registers of a board.

    Parameters
    ----------
    name : str
        Of the board.
    registers : iterable of Register
        In any order; kept by address.

    Raises
    ------
    RegisterError
        If two registers share a name or an address, or an address has more than 16 bits.
    """

    def __init__(self, name: str, registers: Iterable[Register]) -> None:
        self.name = name
        self.registers = tuple(sorted(registers, key=lambda register: register.address))
        self._by_name: dict[str, Register] = {}
        self._by_address: dict[int, Place] = {}
        for register in self.registers:
            if register.name in self._by_name:
                raise RegisterError(f"{name}: register {register.name!r} stands twice")
            self._by_name[register.name] = register
            for indices in register.elements():
                first = register.address_of(*indices)
                for word in range(register.words):
                    self._place(first + word, Place(register, indices, word))

    def _place(self, address: int, place: Place) -> None:
        other = self._by_address.get(address)
        name = place.register.name
        if other is not None:
            raise RegisterError(
                f"{self.name}: {name} and {other.register.name} share address {address:#06x}"
            )
        if not 0 <= address < 1 << ADDRESS_BITS:
            raise RegisterError(f"{self.name}: {name} needs address {address:#x}")
        self._by_address[address] = place

    def __getitem__(self, name: str) -> Register:
        """Return the register called `name`."""
        try:
            return self._by_name[name]
        except KeyError:
            raise RegisterError(f"the {self.name} has no register {name!r}") from None

    def __iter__(self) -> Iterator[Register]:
        """Iterate over the registers by address."""
        return iter(self.registers)

    def __contains__(self, address: object) -> bool:
        """Whether there is a register at a word address."""
        return address in self._by_address

    def at(self, address: int, /) -> Place:
        """Return what stands at a word address.

        Parameters
        ----------
        address : int
            Word address.

        Returns
        -------
        Place
            Register, element and word.
        """
        try:
            return self._by_address[address]
        except KeyError:
            raise RegisterError(f"the {self.name} has no register at {address:#06x}") from None

    @property
    def fingerprint(self) -> int:
        """CRC-32C of the whole declaration but its prose.

        The gateware reports it as a constant, so that a host finds out at once when it speaks
        with a board that was built from another map.
        """
        lines = [
            f"{r.name} {r.address} {r.access.value} {r.count} {r.strides} {r.words} "
            + " ".join(
                f"{n}:{p.shift}+{p.field.width}{'s' if p.field.signed else ''}"
                for n, p in r.fields.items()
            )
            for r in self.registers
        ]
        return crc32c("\n".join([self.name, *lines]).encode())
