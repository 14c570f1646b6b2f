# SPDX-License-Identifier: Apache-2.0
"""The common base of the registers as types, which `tools/typed_registers.py` writes."""

from dataclasses import fields
from typing import ClassVar, Self

from .registers import Register


class RegisterValue:
    """Value of one register, field by field; each register has a dataclass of this kind.

    Attributes
    ----------
    NAME : str
        Name of the register in its map.
    ADDRESS : int
        Word address of the register's first word, or of an array's first element.
    """

    NAME: ClassVar[str]
    ADDRESS: ClassVar[int]

    @classmethod
    def decode(cls, register: Register, value: int, /) -> Self:
        """Take a value apart.

        Parameters
        ----------
        register : Register
            This register in the map of the board.
        value : int
            All words of the register, the low word first.

        Returns
        -------
        RegisterValue
            The fields.
        """
        return cls(**register.decode(value))

    def encode(self, register: Register, /) -> int:
        """Put the fields together; one that the build of the board lacks must be 0.

        Parameters
        ----------
        register : Register
            This register in the map of the board.

        Returns
        -------
        int
            Value of the register.

        Raises
        ------
        RegisterError
            If a field does not fit its width, or the build lacks it.
        """
        values = self.as_dict().items()
        return register.encode(**{n: value for n, value in values if value or n in register.fields})

    def as_dict(self) -> dict[str, int]:
        """Return the fields by name.

        Returns
        -------
        dict of str to int
            Values of all fields.
        """
        return {name: getattr(self, name) for name in self.field_names()}

    @classmethod
    def field_names(cls) -> tuple[str, ...]:
        """Return the names of the fields, from the lowest bit up.

        Returns
        -------
        tuple of str
            Names.
        """
        return tuple(field.name for field in fields(cls))  # pyright: ignore[reportArgumentType]
