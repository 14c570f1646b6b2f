# SPDX-License-Identifier: Apache-2.0
"""Reduction of codes to sums: what the camera's reduction core computes, bit for bit.

Each pixel has a few sums. Every code that a pixel reports adds one entry of each table to them.
Entries are never negative and a sum stays at its greatest value once it would exceed it, so that
the result does not depend on the order of the codes: a histogram gives the same sums as the frames
that it was counted from. A sum at its greatest value is saturated, and tells no more than that.

A pixel's offset moves its codes along the table: the entry is that of ``code + offset``, and where
this leaves the range from the first to the last code it continues at the other end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checksum import crc32c
from .errors import ProtocolError

MOST_SUMS = 32  #: per pixel
MOST_SUM_BITS = 32  #: of a sum
MOST_ENTRY_BITS = 12  #: of a table entry
MOST_OFFSET = 127  #: codes, either way
BLOCK_PIXELS = 512  #: whose histograms are converted at a time, so that they stay in the cache


@dataclass(frozen=True, eq=False)
class ReductionTables:
    """Tables of the reduction, and the widths of its sums.

    Attributes
    ----------
    entries : ndarray of uint16, shape (sum, code)
        What each code adds to each sum; as many codes as the sensor's code width allows.
    widths : tuple of int
        Bits of each sum.
    first, last : int
        Range of codes that stand for a time. All others add nothing.

    Raises
    ------
    ProtocolError
        If the tables have no valid shape, an entry or a width is out of range, or a code outside
        the range of times has an entry.
    """

    entries: NDArray[np.uint16]
    widths: tuple[int, ...]
    first: int
    last: int
    _bits: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        entries = np.asarray(self.entries)
        if entries.ndim != 2 or not 1 <= len(entries) <= MOST_SUMS:
            raise ProtocolError(
                f"entries have shape {entries.shape}: must be (sum, code) with 1 to {MOST_SUMS} "
                "sums"
            )
        bits = int(entries.shape[1] - 1).bit_length()
        if entries.shape[1] != 1 << bits or not 1 <= bits <= 16:
            raise ProtocolError(
                f"entries are for {entries.shape[1]} codes: must be a power of 2 from 2 to 65536"
            )
        if entries.dtype.kind not in "iu" or entries.min() < 0 or entries.max() >> MOST_ENTRY_BITS:
            raise ProtocolError(
                f"entries of type {entries.dtype} from {entries.min()} to {entries.max()}: must be "
                f"whole numbers from 0 to {(1 << MOST_ENTRY_BITS) - 1}"
            )
        wrong = [width for width in self.widths if not 1 <= width <= MOST_SUM_BITS]
        if len(self.widths) != len(entries) or wrong:
            raise ProtocolError(
                f"widths = {self.widths}: must be {len(entries)} numbers from 1 to {MOST_SUM_BITS}"
            )
        if not 0 <= self.first <= self.last < entries.shape[1]:
            raise ProtocolError(
                f"first = {self.first}, last = {self.last}: must be codes in ascending order, at "
                f"most {entries.shape[1] - 1}"
            )
        if entries[:, : self.first].any() or entries[:, self.last + 1 :].any():
            raise ProtocolError(
                f"a code outside the range from {self.first} to {self.last} has an entry: it must "
                "be 0"
            )
        object.__setattr__(self, "entries", np.ascontiguousarray(entries, np.uint16))
        object.__setattr__(self, "widths", tuple(int(width) for width in self.widths))
        object.__setattr__(self, "_bits", bits)

    @property
    def sums(self) -> int:
        """Number of sums per pixel."""
        return len(self.widths)

    @property
    def code_bits(self) -> int:
        """Bits of a code."""
        return self._bits

    @cached_property
    def entry_bits(self) -> int:
        """Bits of the greatest entry."""
        return max(1, int(self.entries.max()).bit_length())

    @cached_property
    def limits(self) -> NDArray[np.uint64]:
        """Greatest value of each sum, shape (sum,); a sum that has it is saturated."""
        return np.array([(1 << width) - 1 for width in self.widths], np.uint64)

    @cached_property
    def hash(self) -> int:
        """CRC-32C of the tables; packets of sums state it.

        It covers, each as little-endian uint16: the number of sums, the bits of a code, the first
        and the last code, the width of each sum, and the entries in order of sum and code.
        """
        head = [self.sums, self.code_bits, self.first, self.last, *self.widths]
        return crc32c(np.array(head, "<u2").tobytes() + self.entries.astype("<u2").tobytes())

    def places(self, offset: int) -> NDArray[np.intp]:
        """Return which code's entry each code adds in a pixel with an offset.

        Parameters
        ----------
        offset : int
            Offset of the pixel, codes.

        Returns
        -------
        ndarray of int, shape (code,)
            Places in the tables. Codes outside the range of times have their own.
        """
        codes = np.arange(self.entries.shape[1])
        count = self.last - self.first + 1
        moved = self.first + (codes - self.first + offset) % count
        return np.where((codes >= self.first) & (codes <= self.last), moved, codes)

    def of_offset(self, offset: int) -> NDArray[np.uint16]:
        """Return what each code adds in a pixel with an offset.

        Parameters
        ----------
        offset : int
            Offset of the pixel, codes.

        Returns
        -------
        ndarray of uint16, shape (sum, code)
            Entries.
        """
        return self.entries[:, self.places(offset)]


def offsets_hash(offsets: NDArray[np.integer], /) -> int:
    """Return what packets of sums state about the offsets.

    Parameters
    ----------
    offsets : ndarray of int, shape (pixel,)
        Offset of each pixel, codes.

    Returns
    -------
    int
        CRC-32C of the offsets, a signed byte each; 0 where none is moved.
    """
    return crc32c(offsets.astype(np.int8).tobytes()) if offsets.any() else 0


def check_offsets(offsets: ArrayLike | None, tables: ReductionTables, pixels: int) -> NDArray:
    """Return the offset of each pixel, checked.

    Parameters
    ----------
    offsets : array_like of int, or None
        An offset for each pixel; None for none.
    tables : ReductionTables
        Tables of the reduction.
    pixels : int
        Number of pixels.

    Returns
    -------
    ndarray of int, shape (pixel,)
        Offsets.

    Raises
    ------
    ProtocolError
        If there are more or fewer than pixels, or one is out of range.
    """
    if offsets is None:
        return np.zeros(pixels, np.intp)
    given = np.asarray(offsets)
    if given.size != pixels or given.dtype.kind not in "iu":
        raise ProtocolError(
            f"offsets of shape {given.shape} and type {given.dtype}: must be {pixels} whole numbers"
        )
    most = min(MOST_OFFSET, tables.last - tables.first)
    if pixels and np.abs(given).max() > most:
        worst = given.flat[np.abs(given).argmax()]
        raise ProtocolError(f"offset {worst} is out of range: at most {most} codes either way")
    return given.reshape(-1).astype(np.intp)


def reduce_codes(
    frames: ArrayLike,
    tables: ReductionTables,
    /,
    *,
    offsets: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    gate: tuple[int, int] | None = None,
) -> NDArray[np.uint64]:
    """Reduce frames to sums.

    Parameters
    ----------
    frames : array_like of int, shape (frame, pixel)
        Codes; 0 where a pixel reports no photon.
    tables : ReductionTables
        Tables of the reduction.
    offsets : array_like of int, shape (pixel,), optional
        Offset of each pixel, codes.
    mask : array_like of bool, shape (pixel,), optional
        True for pixels that are left out, as hot ones.
    gate : tuple of int, optional
        First and last code that count.

    Returns
    -------
    ndarray of uint64, shape (pixel, sum)
        Sums; one at its greatest value is saturated.
    """
    codes = np.asarray(frames)
    each = check_offsets(offsets, tables, codes.shape[1])
    low, high = (tables.first, tables.last) if gate is None else gate
    kept = (codes >= max(low, tables.first)) & (codes <= min(high, tables.last))
    if mask is not None:
        kept &= ~np.asarray(mask, bool)
    count = tables.last - tables.first + 1
    places = tables.first + (codes.astype(np.intp) - tables.first + each) % count
    result = np.empty((codes.shape[1], tables.sums), np.uint64)
    for number, (entries, limit) in enumerate(zip(tables.entries, tables.limits, strict=True)):
        added = np.where(kept, entries[np.where(kept, places, 0)], 0)
        result[:, number] = np.minimum(added.sum(axis=0, dtype=np.uint64), limit)
    return result


def reduce_histogram(
    counts: ArrayLike, tables: ReductionTables, /, *, offsets: ArrayLike | None = None
) -> NDArray[np.uint64]:
    """Reduce histograms to the sums that their frames give.

    Parameters
    ----------
    counts : array_like of int, shape (pixel, code)
        Counts of each code.
    tables : ReductionTables
        Tables of the reduction.
    offsets : array_like of int, shape (pixel,), optional
        Offset of each pixel, codes.

    Returns
    -------
    ndarray of uint64, shape (pixel, sum)
        Sums; one at its greatest value is saturated.

    Raises
    ------
    ProtocolError
        If the histograms have another number of codes than the tables.
    """
    given = np.asarray(counts)
    if given.ndim != 2 or given.shape[1] != tables.entries.shape[1]:
        raise ProtocolError(
            f"histograms have shape {given.shape}: must be (pixel, {tables.entries.shape[1]})"
        )
    each = check_offsets(offsets, tables, len(given))
    result = np.empty((len(given), tables.sums), np.uint64)
    timed = slice(tables.first, tables.last + 1)
    for offset in np.unique(each):
        here = np.flatnonzero(each == offset)
        entries = tables.of_offset(int(offset))[:, timed].astype(np.float64)
        for start in range(0, here.size, BLOCK_PIXELS):
            some = here[start : start + BLOCK_PIXELS]
            # products of float64 are exact up to 2**53, far more than a sum holds
            exact = given[some][:, timed].astype(np.float64) @ entries.T
            result[some] = np.minimum(exact, tables.limits.astype(np.float64)).astype(np.uint64)
    return result
