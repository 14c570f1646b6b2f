# SPDX-License-Identifier: Apache-2.0
"""Registers of a camera that can reduce codes to sums; builds without reduction lack them."""

from dataclasses import dataclass
from enum import IntEnum

from .errors import RegisterError
from .reduction import MOST_ENTRY_BITS, MOST_SUM_BITS, MOST_SUMS
from .registers import Access, Field, Register, Reserved, value

MOST_GROUP = 64  #: pixels whose offsets are written together, at most


class ReductionMode(IntEnum):
    """What a camera sends."""

    CODES = 0
    SUMS = 1
    BOTH = 2


@dataclass(frozen=True)
class ReductionRoom:
    """What a build has room for.

    Parameters
    ----------
    sums, entry_bits, sum_bits : int
        Sums per pixel, bits of a table entry and of a sum.
    group : int
        Pixels whose offsets are written together, a multiple of 4.
    narrow : int
        Number of the last sums that have one bit less.

    Raises
    ------
    RegisterError
        If a number is out of its range.
    """

    sums: int = MOST_SUMS
    entry_bits: int = MOST_ENTRY_BITS
    sum_bits: int = MOST_SUM_BITS
    group: int = MOST_GROUP
    narrow: int = 0

    def __post_init__(self) -> None:
        for name, most in (
            ("sums", MOST_SUMS), ("entry_bits", MOST_ENTRY_BITS), ("sum_bits", MOST_SUM_BITS),
            ("group", MOST_GROUP),
        ):  # fmt: skip
            number = getattr(self, name)
            if not 1 <= number <= most:
                raise RegisterError(f"{name} = {number}: must be from 1 to {most}")
        if self.group % 4:
            raise RegisterError(f"group = {self.group}: must be a multiple of 4")
        if not 0 <= self.narrow <= self.sums or (self.narrow and self.sum_bits < 2):
            raise RegisterError(
                f"narrow = {self.narrow}: must be from 0 to {self.sums}, of sums of 2 bits or more"
            )

    @property
    def widths(self) -> tuple[int, ...]:
        """Bits of each sum."""
        wide = self.sums - self.narrow
        return (self.sum_bits,) * wide + (self.sum_bits - 1,) * self.narrow


def reduction_registers(room: ReductionRoom, /) -> list[Register]:
    """Return the registers of the reduction.

    Parameters
    ----------
    room : ReductionRoom
        What the build has room for.

    Returns
    -------
    list of Register
        The registers. All but those that store are taken over when a capture begins.
    """
    rw = Access.RW
    return [
        Register(
            "reduction_room",
            0x050,
            Access.CONST,
            (
                Field("sums", 8, "sums per pixel", reset=room.sums),
                Field("entry_bits", 8, "of a table entry", reset=room.entry_bits, unit="bit"),
                Field("sum_bits", 8, "of a sum", reset=room.sum_bits, unit="bit"),
                Field(
                    "group", 8, "whose offsets are stored together", reset=room.group, unit="pixel"
                ),
            ),
            "what the reduction has room for",
        ),
        Register(
            "reduction",
            0x051,
            rw,
            (
                Field("mode", 2, "what is sent", choices=ReductionMode),
                Reserved(6),
                Field("sums", 8, "sums per pixel in use"),
            ),
            "what is sent",
        ),
        Register(
            "reduction_frames",
            0x052,
            rw,
            value(32, "1 or more", reset=1, unit="frame"),
            "frames of a picture",
        ),
        Register(
            "reduction_codes",
            0x053,
            rw,
            (Field("first", 16, "first code that adds"), Field("last", 16, "last code that adds")),
            "range of codes that stand for a time",
        ),
        Register(
            "reduction_tables", 0x054, rw, value(32, "as packets state it"), "hash of the tables"
        ),
        Register(
            "reduction_moved", 0x055, rw, value(32, "as packets state it"), "CRC-32C of the offsets"
        ),
        Register(
            "reduction_store",
            0x056,
            Access.PULSE,
            value(16, "code whose entries `reduction_entries` holds"),
            "store entries in the tables; only between captures",
        ),
        Register(
            "reduction_move",
            0x057,
            Access.PULSE,
            value(20, "group of pixels whose offsets `reduction_offsets` holds"),
            "store offsets; only between captures",
        ),
        Register(
            "reduction_narrow",
            0x058,
            Access.CONST,
            value(8, "last sums, of those that there is room for", reset=room.narrow),
            "sums that have one bit less than `reduction_room` says",
        ),
        Register(
            "reduction_width",
            0x060,
            rw,
            value(6, "1 or more", unit="bit"),
            "width of each sum",
            count=(MOST_SUMS,),
            strides=(1,),
        ),
        Register(
            "reduction_entries",
            0x080,
            rw,
            (Field("even", 16, "of sum 2·w"), Field("odd", 16, "of sum 2·w + 1")),
            "entries of one code; word w holds those of two sums",
            count=(MOST_SUMS // 2,),
            strides=(1,),
        ),
        Register(
            "reduction_offsets",
            0x0A0,
            rw,
            value(32, "byte b of word w: pixel 4·w + b of the group, signed"),
            "offsets of one group of pixels",
            count=(MOST_GROUP // 4,),
            strides=(1,),
        ),
    ]
