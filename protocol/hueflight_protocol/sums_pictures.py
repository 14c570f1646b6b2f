# SPDX-License-Identifier: Apache-2.0
"""Pictures from the packets of sums that make them up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .sums_packet import Sums

_COMMON = ("picture", "rows", "cols", "tables", "offsets", "code_bits", "widths")
"""What the packets of a picture have in common; each has frames of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class SumsPicture:
    """A picture of sums.

    Attributes
    ----------
    values : ndarray of uint32, shape (row, col, sum)
        Sums; 0 where the pixel is not present.
    present : ndarray of bool, shape (row, col)
        Pixels whose packet arrived.
    frames : ndarray of int64, shape (row, col)
        Frames that the sums of each pixel hold; 0 where it is not present.
    missed : ndarray of int64, shape (row, col)
        Frames that came meanwhile and are not in them; 0 where it is not present.
    first : Sums
        The first packet of the picture, which tells what all of them have in common.
    """

    values: NDArray[np.uint32]
    present: NDArray[np.bool_]
    frames: NDArray[np.int64]
    missed: NDArray[np.int64]
    first: Sums

    @property
    def complete(self) -> bool:
        """Whether all pixels are present."""
        return bool(self.present.all())


class PictureAssembler:
    """Joins packets of sums to pictures; parts that are missing stay visible."""

    def __init__(self) -> None:
        self._first: Sums | None = None
        self._parts: list[Sums] = []

    def feed(self, part: Sums) -> SumsPicture | None:
        """Take a packet.

        Parameters
        ----------
        part : Sums
            The next packet of sums of the stream.

        Returns
        -------
        SumsPicture or None
            A picture that this packet completes, or that it shows to be over.
        """
        finished = None
        if self._first is not None and not self._continues(part):
            finished = self.finish()
        if self._first is None:
            self._first = part
        self._parts.append(part)
        if finished is None and part.first_pixel + len(part.values) == part.rows * part.cols:
            return self.finish()
        return finished

    def finish(self) -> SumsPicture | None:
        """End the picture that is being joined.

        Returns
        -------
        SumsPicture or None
            The picture, complete or not; None if there was no packet.
        """
        first = self._first
        if first is None:
            return None
        values = np.zeros((first.rows * first.cols, len(first.widths)), np.uint32)
        present = np.zeros(len(values), bool)
        frames, missed = np.zeros((2, len(values)), np.int64)
        for part in self._parts:
            here = slice(part.first_pixel, part.first_pixel + len(part.values))
            values[here], present[here] = part.values, True
            frames[here], missed[here] = part.frames, part.missed
        self._first, self._parts = None, []
        shape = first.rows, first.cols
        return SumsPicture(
            values.reshape(*shape, -1),
            present.reshape(shape),
            frames.reshape(shape),
            missed.reshape(shape),
            first,
        )

    def _continues(self, part: Sums) -> bool:
        """Tell whether a packet belongs to the picture that is being joined."""
        first, last = self._first, self._parts[-1]
        same = all(getattr(part, name) == getattr(first, name) for name in _COMMON)
        after = part.first_pixel >= last.first_pixel + len(last.values)
        return same and after and part.header.capture == last.header.capture
