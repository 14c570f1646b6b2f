# SPDX-License-Identifier: Apache-2.0
"""What a sensor sends on its lanes: words, training, the begin and the end of a frame.

Each data lane carries the codes of one lane of the sensor port, and one more lane, the *control*
lane, what belongs to the codes of all of them. All lanes send words of the same length at the same
time, the lowest bit first, at both edges of the sensor's clock:

1. Between frames all lanes repeat the training word, without end.
2. A frame begins with one start word on all lanes.
3. Then the control lane sends a control word for each word of the data lanes: whether they are
   codes, and the marks of the sensor port (first, row, last).
4. After the word with the mark `last` all lanes send at least one training word.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from amaranth.lib import data

from ...frame_format import FormatError, FrameFormat

FLAGS = ("valid", "first", "row", "last")
"""Bits of a control word, lowest first; the next four bits are their complement, the rest 0."""
GEARS = (2, 4)
WORD_BITS = (12, 16, 20)


@dataclass(frozen=True, kw_only=True)
class LinkFormat:
    """Words and lanes of a sensor's serial link.

    Parameters
    ----------
    form : FrameFormat
        Geometry and code width; a data lane for each of its lanes.
    word_bits : int
        Bits of a word: 12, 16 or 20, and more than those of a code.
    gear : int
        Bits of a lane that the I/O registers give in each clock of the domain `sensor`: 2 or 4.

    Raises
    ------
    FormatError
        If a number is out of its range.
    """

    form: FrameFormat = field(default_factory=FrameFormat)
    word_bits: int = 12
    gear: int = 4

    def __post_init__(self) -> None:
        if self.gear not in GEARS:
            raise FormatError(f"gear = {self.gear}: must be one of {GEARS}")
        if self.word_bits not in WORD_BITS or self.word_bits <= self.form.code_bits:
            raise FormatError(
                f"word_bits = {self.word_bits}: must be one of {WORD_BITS}, and more than the "
                f"{self.form.code_bits} bits of a code"
            )

    @property
    def lanes(self) -> int:
        """Lanes with data, and the control lane, which is the last."""
        return self.form.lanes + 1

    @property
    def clocks_per_word(self) -> int:
        """Clocks of the domain `sensor` in which a word comes."""
        return self.word_bits // self.gear

    @property
    def training(self) -> int:
        """The training word.

        The number of its ones has no divisor in common with the number of its bits, so that it
        looks the same at one bit position only.
        """
        ones = [0, *range(1, self.word_bits - 4, 2)]
        return sum(1 << bit for bit in ones)

    @property
    def start(self) -> int:
        """The start word: the complement of the training word, at no bit position equal to it.

        Its highest bit is set, as in no code and no control word.
        """
        return self.training ^ ((1 << self.word_bits) - 1)

    @property
    def samples_layout(self) -> data.ArrayLayout:
        """One clock of all lanes: `gear` bits of each, the earliest lowest."""
        return data.ArrayLayout(self.gear, self.lanes)


def control_word(flags: int, /) -> int:
    """Return the control word for `FLAGS`, as bits of an integer or of an array of integers."""
    return flags | (flags ^ 0xF) << 4
