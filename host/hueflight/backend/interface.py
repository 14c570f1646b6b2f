# SPDX-License-Identifier: Apache-2.0
"""What C and Python of a kernel have to agree on: declared once, here in Python.

From a declaration `tools/generate_kernel_headers.py` writes the C header ``_c/abi.h``, in which
constants, records and arguments have the same names. A hash of the header is compiled into the
extension module and compared when it is loaded, so that a module that was built from another
declaration is refused instead of reading its arguments at wrong places.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

C_TYPES = {
    "int32": "int32_t",
    "int64": "int64_t",
    "float32": "float",
    "float64": "double",
}
COUNTS = "counts"  #: type of a buffer of uint16, uint32 or float32
ANY = "any"  #: type of a buffer that the C source checks itself


@dataclass(frozen=True)
class Constant:
    """A number that C and Python share.

    Attributes
    ----------
    name : str
        Its name in C.
    value : int or float
        Its value.
    about : str
        What it means.
    """

    name: str
    value: int | float
    about: str = ""

    def declaration(self) -> str:
        """Return the line of C that defines it."""
        comment = f" /* {self.about} */" if self.about else ""
        if isinstance(self.value, float):
            return f"#define {self.name} {self.value!r}f{comment}"
        return f"enum {{ {self.name} = {self.value} }};{comment}"


@dataclass(frozen=True)
class Field:
    """A member of a record.

    Attributes
    ----------
    name : str
        Its name in C and Python.
    type : str
        A key of `C_TYPES`.
    about : str
        What it means.
    size : int
        Number of elements, if it is an array.
    """

    name: str
    type: str
    about: str = ""
    size: int = 1


@dataclass(frozen=True)
class Record:
    """Numbers that are handed over together: a struct in C, a structured array in Python.

    Attributes
    ----------
    name : str
        Name of the struct.
    about : str
        What it holds.
    fields : tuple of Field
        Its members in the order of memory, arranged so that C inserts no padding.
    """

    name: str
    about: str
    fields: tuple[Field, ...]

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Layout of the record for NumPy."""
        return np.dtype([(f.name, f.type, (f.size,) if f.size > 1 else ()) for f in self.fields])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields."""
        return tuple(field.name for field in self.fields)

    def pack(self, **values: Any) -> NDArray[np.void]:
        """Return an array of one record.

        Parameters
        ----------
        **values : number or sequence of numbers
            A value for each field.

        Returns
        -------
        ndarray of void, shape (1,)
            The record.

        Raises
        ------
        TypeError
            If a field is missing or there is one too many.
        """
        if values.keys() != set(self.names):
            wrong = ", ".join(sorted(values.keys() ^ set(self.names)))
            raise TypeError(f"{self.name}: missing or unknown fields: {wrong}")
        record = np.zeros(1, self.dtype)
        for name, value in values.items():
            record[name] = value
        return record

    def declaration(self) -> str:
        """Return the struct in C."""
        lines = []
        for field in self.fields:
            size = f"[{field.size}]" if field.size > 1 else ""
            comment = f" /* {field.about} */" if field.about else ""
            lines.append(f"    {C_TYPES[field.type]} {field.name}{size};{comment}")
        body = "\n".join(lines)
        return f"/* {self.about} */\ntypedef struct {{\n{body}\n}} {self.name};\n" + (
            f"_Static_assert(sizeof({self.name}) == {self.dtype.itemsize}, "
            f'"{self.name} is laid out as NumPy lays it out");'
        )


@dataclass(frozen=True)
class Buffer:
    """An argument that is a contiguous array, or counts with any strides.

    Attributes
    ----------
    name : str
        Its name in C and Python.
    type : str or Record
        NumPy's name of its type, a record, `COUNTS` or `ANY`.
    about : str
        What it holds.
    """

    name: str
    type: str | Record
    about: str = ""


@dataclass(frozen=True)
class Function:
    """A function whose arguments are buffers.

    Attributes
    ----------
    name : str
        Its name in C and Python.
    about : str
        What it does.
    reads, writes : tuple of Buffer
        Its arguments in order: first those that it reads, then those that it fills.
    """

    name: str
    about: str
    reads: tuple[Buffer, ...]
    writes: tuple[Buffer, ...]

    @property
    def buffers(self) -> tuple[Buffer, ...]:
        """All arguments in order."""
        return self.reads + self.writes

    def arguments(self, **buffers: NDArray[Any]) -> list[NDArray[Any]]:
        """Return the arguments in the order in which the function takes them.

        Parameters
        ----------
        **buffers : ndarray
            An array for each argument.

        Returns
        -------
        list of ndarray
            The arrays in order.

        Raises
        ------
        TypeError
            If an argument is missing, unknown or of another type than declared.
        """
        names = {buffer.name for buffer in self.buffers}
        if buffers.keys() != names:
            wrong = ", ".join(sorted(buffers.keys() ^ names))
            raise TypeError(f"{self.name}: missing or unknown arguments: {wrong}")
        for buffer in self.buffers:
            given = buffers[buffer.name].dtype
            expected = buffer.type.dtype if isinstance(buffer.type, Record) else buffer.type
            if expected not in (COUNTS, ANY) and given != expected:
                raise TypeError(f"{self.name}: {buffer.name} is {given}, expected {expected}")
        return [buffers[buffer.name] for buffer in self.buffers]

    def declaration(self) -> str:
        """Return the places of the arguments in C."""
        prefix = self.name.upper()
        lines = []
        for number, buffer in enumerate(self.buffers):
            kind = buffer.type.name if isinstance(buffer.type, Record) else buffer.type
            about = f": {buffer.about}" if buffer.about else ""
            lines.append(f"    {prefix}_{buffer.name.upper()} = {number}, /* {kind}{about} */")
        lines.append(f"    {prefix}_READS = {len(self.reads)},")
        lines.append(f"    {prefix}_BUFFERS = {len(self.buffers)}")
        return f"/* {self.name}: {self.about} */\nenum {{\n" + "\n".join(lines) + "\n};"


@dataclass(frozen=True)
class ScalarFunction:
    """A function that takes numbers and objects, as `PyArg_ParseTuple` reads them.

    Attributes
    ----------
    name : str
        Its name in C and Python.
    about : str
        What it returns.
    parameters : tuple of (str, str)
        Name and format unit of each parameter, in order.
    """

    name: str
    about: str
    parameters: tuple[tuple[str, str], ...]

    def declaration(self) -> str:
        """Return the format of the arguments in C."""
        names = ", ".join(name for name, _ in self.parameters)
        units = "".join(unit for _, unit in self.parameters)
        return (
            f"/* {self.name}({names}): {self.about} */\n"
            f'#define {self.name.upper()}_ARGUMENTS "{units}"'
        )


@dataclass(frozen=True)
class Interface:
    """All that C and Python of a kernel agree on.

    Attributes
    ----------
    name : str
        Name of the kernel.
    constants : tuple of Constant
        Numbers that both use.
    records : tuple of Record
        Structs that both use.
    functions : tuple of Function or ScalarFunction
        What the extension module offers.
    """

    name: str
    constants: tuple[Constant, ...]
    records: tuple[Record, ...]
    functions: tuple[Function | ScalarFunction, ...]

    @cached_property
    def _body(self) -> str:
        parts = [constant.declaration() for constant in self.constants]
        for part in (*self.records, *self.functions):
            parts += ["", part.declaration()]
        return "\n".join(parts)

    @cached_property
    def hash(self) -> str:
        """Hash of all declarations, 16 hexadecimal digits."""
        return sha256(self._body.encode()).hexdigest()[:16]

    def header(self) -> str:
        """Return the C header.

        Returns
        -------
        str
            Text of ``abi.h``.
        """
        guard = f"HUEFLIGHT_{self.name.upper()}_ABI_H"
        return (
            "/* SPDX-License-Identifier: Apache-2.0 */\n"
            f"/* Made by tools/generate_kernel_headers.py from hueflight/backend/{self.name}.py:\n"
            " * change that file and run the tool. */\n"
            f"#ifndef {guard}\n#define {guard}\n#include <stdint.h>\n\n"
            f'#define ABI "{self.hash}" /* hash of what follows */\n\n{self._body}\n\n#endif\n'
        )
