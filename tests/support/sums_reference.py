# SPDX-License-Identifier: Apache-2.0
"""What packets of sums must hold, from the frames that a sensor gave.

Every packet says itself how many frames its pixels hold and miss, so a reference needs to know
nothing of when the camera ends a picture.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hueflight_protocol import Packet, PictureAssembler, Sums, encode_sums
from hueflight_protocol.reduction import ReductionTables, offsets_hash, reduce_codes


def draw_tables(
    rng: np.random.Generator, *, code_bits: int, sums: int, entry_bits: int, sum_bits: int
) -> ReductionTables:
    """Tables with entries, widths and a range of codes at random; some sums saturate, some do not.

    Parameters
    ----------
    rng : Generator
        Source of chance.
    code_bits, sums : int
        Bits of a code; sums per pixel.
    entry_bits, sum_bits : int
        Bits of the greatest entry and of the widest sum, at most.
    """
    codes = 1 << code_bits
    first = int(rng.integers(1, codes // 4))
    last = int(rng.integers(codes // 2, codes))
    bits = rng.integers(1, entry_bits + 1, sums)
    entries = np.zeros((sums, codes), np.uint16)
    for row, most in zip(entries, bits, strict=True):
        row[first : last + 1] = rng.integers(0, 1 << most, last - first + 1)
    widths = [int(rng.integers(1, sum_bits + 1)) if rng.random() < 0.3 else sum_bits for _ in bits]
    return ReductionTables(entries, tuple(widths), first, last)


def draw_offsets(
    rng: np.random.Generator, tables: ReductionTables, pixels: int
) -> NDArray[np.integer]:
    """Offsets at random, of both signs and as large as tables and registers allow."""
    most = min(127, tables.last - tables.first)
    return rng.integers(-most, most + 1, pixels)


@dataclass
class SumsReference:
    """The frames of a capture, to compare packets of sums with.

    Parameters
    ----------
    tables : ReductionTables
        Tables of the camera.
    offsets : ndarray of int, shape (pixel,)
        Offset of each pixel.
    frames : sequence of ndarray, shape (pixel,)
        Codes of all frames of the capture, after the filters.
    shape : tuple of int
        Rows and columns.
    dropped, cut : set of int
        Frames of which nothing came, and frames that ended early: these take with them what was
        gathered before in the same window.
    """

    tables: ReductionTables
    offsets: NDArray[np.integer]
    frames: Sequence[NDArray[np.integer]]
    shape: tuple[int, int]
    dropped: frozenset[int] = frozenset()
    cut: frozenset[int] = frozenset()
    held: int = 0  #: frames that the packets of pixel 0 held so far
    pictures: int = 0  #: complete ones
    _seen: dict[int, tuple[int, int]] = field(default_factory=dict)  # by first pixel
    _next: int = 0

    def check(self, part: Sums) -> None:
        """Compare a packet, the next of the stream, with the definition of the reduction."""
        first, pixels = part.first_pixel, len(part.values)
        here = slice(first, first + pixels)
        assert first == self._next, "a part of a picture is missing"
        self._next = 0 if here.stop == part.rows * part.cols else here.stop
        self.pictures += self._next == 0
        picture, start = self._seen.get(first, (0, 0))
        end = start + part.frames + part.missed
        assert end <= len(self.frames), f"pixels from {first}: more frames than there were"
        added = self._added(start, end)
        assert (part.picture, part.frames) == (picture, len(added))
        self._seen[first] = picture + 1, end
        self.held += part.frames * (first == 0)

        tables = self.tables
        codes = np.array([self.frames[number][here] for number in added], np.uint16)
        codes = codes.reshape(-1, pixels)
        expected = reduce_codes(codes, tables, offsets=self.offsets[here])
        np.testing.assert_array_equal(part.values, expected)
        assert part.photons == ((codes >= tables.first) & (codes <= tables.last)).sum()
        assert (part.rows, part.cols) == self.shape
        assert (part.widths, part.code_bits) == (tables.widths, tables.code_bits)
        assert (part.tables, part.offsets) == (tables.hash, offsets_hash(self.offsets))

    def check_packets(self, packets: Iterable[Packet]) -> list[Sums]:
        """Compare all packets of sums of a capture, byte for byte; return their contents."""
        assembler, parts = PictureAssembler(), []
        for packet in packets:
            if isinstance(packet.content, Sums):
                assert encode_sums(packet.content) == packet.data
                self.check(packet.content)
                parts.append(packet.content)
                picture = assembler.feed(packet.content)
                assert picture is None or picture.complete
        return parts

    def check_end(self) -> None:
        """Check that packets have told of all frames."""
        assert self._next == 0, "a part of the last picture is missing"
        for first, (_, end) in self._seen.items():
            assert end == len(self.frames), f"pixels from {first}: frames from {end} are missing"

    def _added(self, start: int, end: int) -> list[int]:
        """Which frames a picture holds, of those from `start` to `end`."""
        added: list[int] = []
        for number in range(start, end):
            if number in self.cut:
                added.clear()
            elif number not in self.dropped:
                added.append(number)
        return added
