# SPDX-License-Identifier: Apache-2.0
"""Fixed-size layouts: one ``construct`` declaration, and all that derives from it.

The declaration is the definition. From it come the byte offsets that the C kernel and the
gateware use, a NumPy dtype for views over whole recordings, a compiled ``struct`` for the
fast path, and the tables of the specification. Nothing is typed twice.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import construct
import numpy as np

from .errors import ProtocolError

# construct's own integers; their type stubs take them for functions.
U8: Any = construct.Int8ul
U16: Any = construct.Int16ul
U32: Any = construct.Int32ul
U64: Any = construct.Int64ul
I32: Any = construct.Int32sl
I64: Any = construct.Int64sl

# Letters of the struct module, which construct uses, and NumPy's names for the same integers.
_NUMPY_CODES = {
    "B": "u1",
    "H": "<u2",
    "L": "<u4",
    "Q": "<u8",
    "b": "i1",
    "h": "<i2",
    "l": "<i4",
    "q": "<i8",
}


@dataclass(frozen=True, slots=True)
class LayoutField:
    """One field of a `Layout`: where it stands, how wide it is, what it means."""

    name: str
    offset: int
    size: int
    dtype: np.dtype[Any]
    constant: int | None
    doc: str


def _bare(subcon: Any) -> Any:
    """Return a subcon without its names and documentation."""
    while isinstance(subcon, construct.Renamed):
        subcon = subcon.subcon
    return subcon


def _fields(declaration: construct.Struct) -> tuple[LayoutField, ...]:
    fields: list[LayoutField] = []
    offset = 0
    for renamed in declaration.subcons:
        inner = _bare(renamed)
        constant = None
        if isinstance(inner, construct.Const):
            constant, inner = inner.value, _bare(inner.subcon)
        if not isinstance(inner, construct.FormatField):
            raise ProtocolError(
                f"field {renamed.name!r} is a {type(inner).__name__}, not an integer"
            )
        byte_order, code = inner.fmtstr
        if byte_order != "<":
            raise ProtocolError(f"field {renamed.name!r} is not little-endian")
        size = inner.sizeof()
        dtype = np.dtype(_NUMPY_CODES[code])
        fields.append(LayoutField(renamed.name, offset, size, dtype, constant, renamed.docs))
        offset += size
    return tuple(fields)


class Layout:
    """A fixed-size little-endian record, derived from a ``construct.Struct`` of integers.

    Parameters
    ----------
    declaration : construct.Struct
        Integer fields only; ``Const`` marks fields with a fixed value, ``*`` adds their
        documentation.

    Attributes
    ----------
    fields : tuple of LayoutField
        In wire order.
    size : int
        Bytes.
    dtype : numpy.dtype
        Structured dtype with the same names and offsets, for views.

    Raises
    ------
    ProtocolError
        If a field is not a little-endian integer.
    """

    def __init__(self, declaration: construct.Struct) -> None:
        self.declaration = declaration
        self.fields = _fields(declaration)
        self.size: int = declaration.sizeof()
        self.dtype: np.dtype[Any] = np.dtype([(field.name, field.dtype) for field in self.fields])
        self._by_name = {field.name: field for field in self.fields}
        codes = {np.dtype(text): code for code, text in _NUMPY_CODES.items()}
        letters = "".join(codes[field.dtype] for field in self.fields)
        self._struct = struct.Struct("<" + letters)

    def __getitem__(self, name: str) -> LayoutField:
        """Return the field called `name`."""
        return self._by_name[name]

    def offset(self, name: str) -> int:
        """Return the byte offset of a field."""
        return self._by_name[name].offset

    def pack(self, values: Mapping[str, int], /) -> bytes:
        """Return the record as bytes; fields with a constant need no value.

        Raises
        ------
        ProtocolError
            If a value is missing or does not fit its field.
        """
        row: list[int] = []
        for field in self.fields:
            value = field.constant if field.constant is not None else values.get(field.name)
            if value is None:
                raise ProtocolError(f"no value for field {field.name!r}")
            row.append(value)
        try:
            return self._struct.pack(*row)
        except struct.error:
            raise ProtocolError(self._misfit(row)) from None

    def _misfit(self, row: list[int]) -> str:
        for field, value in zip(self.fields, row, strict=True):
            info = np.iinfo(field.dtype)
            if not isinstance(value, int) or not info.min <= value <= info.max:
                return f"{field.name} = {value!r}: must be an integer from {info.min} to {info.max}"
        return "a value does not fit its field"

    def unpack(self, buffer: bytes | bytearray | memoryview, offset: int = 0, /) -> dict[str, int]:
        """Return the record at `offset` as a dictionary of integers; constants unchecked."""
        values = self._struct.unpack_from(buffer, offset)
        return {field.name: value for field, value in zip(self.fields, values, strict=True)}


@dataclass(frozen=True, slots=True)
class BitField:
    """One field of a `BitLayout`: lowest bit, width, meaning."""

    name: str
    shift: int
    width: int
    doc: str

    @property
    def mask(self) -> int:
        """Ones at the field's width, not shifted."""
        return (1 << self.width) - 1


class BitLayout:
    """Bit fields in one little-endian word, derived from a ``construct.BitStruct``.

    Parameters
    ----------
    declaration : construct subcon
        A ``BitStruct`` of ``BitsInteger``, most significant field first as ``construct``
        has it.
    """

    def __init__(self, declaration: Any) -> None:
        self.declaration = construct.ByteSwapped(declaration)
        self.size: int = declaration.sizeof()
        fields: list[BitField] = []
        shift = 8 * self.size
        for renamed in declaration.subcon.subcons:
            width = _bare(renamed).length
            shift -= width
            fields.append(BitField(renamed.name, shift, width, renamed.docs))
        self.fields = tuple(reversed(fields))
        self._by_name = {field.name: field for field in self.fields}

    def __getitem__(self, name: str) -> BitField:
        """Return the field called `name`."""
        return self._by_name[name]

    def pack(self, **values: int) -> int:
        """Return the word that holds `values`."""
        word = 0
        for name, value in values.items():
            field = self._by_name[name]
            if not 0 <= value <= field.mask:
                raise ProtocolError(f"{name} = {value}: must be from 0 to {field.mask}")
            word |= value << field.shift
        return word

    def unpack(self, word: int, /) -> dict[str, int]:
        """Return the fields of `word`."""
        return {field.name: word >> field.shift & field.mask for field in self.fields}
