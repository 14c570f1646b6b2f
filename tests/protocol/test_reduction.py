# SPDX-License-Identifier: Apache-2.0
"""Sums of codes: against a loop over single codes, and the same from frames and from histograms."""

import numpy as np
import pytest

from hueflight_protocol.errors import ProtocolError
from hueflight_protocol.reduction import ReductionTables, reduce_codes, reduce_histogram

FIRST, LAST = 1, 12


def random_tables(seed: int, *, widths: tuple[int, ...] = (10, 6, 8)) -> ReductionTables:
    entries = np.zeros((len(widths), 16), np.uint16)
    entries[:, FIRST : LAST + 1] = np.random.default_rng(seed).integers(
        0, 16, (len(widths), LAST - FIRST + 1)
    )
    return ReductionTables(entries, widths, FIRST, LAST)


def by_hand(frames, tables, offsets, mask, gate):
    """Sums of one code after another, each as wide as its register."""
    sums = [[0] * tables.sums for _ in offsets]
    for codes in frames:
        for pixel, code in enumerate(codes):
            if mask[pixel] or not gate[0] <= code <= gate[1] or not FIRST <= code <= LAST:
                continue
            place = int(code) + int(offsets[pixel])
            if place > LAST:
                place -= LAST - FIRST + 1
            if place < FIRST:
                place += LAST - FIRST + 1
            for number, width in enumerate(tables.widths):
                value = sums[pixel][number] + int(tables.entries[number, place])
                sums[pixel][number] = min(value, 2**width - 1)
    return sums


@pytest.mark.parametrize("seed", range(4))
def test_frames_give_the_sums_of_single_codes(seed):
    rng = np.random.default_rng(seed)
    tables = random_tables(seed)
    frames = rng.integers(0, 16, (40, 9))
    offsets, mask = rng.integers(-11, 12, 9), rng.random(9) < 0.2
    gate = (2, 13)
    found = reduce_codes(frames, tables, offsets=offsets, mask=mask, gate=gate)
    assert found.tolist() == by_hand(frames, tables, offsets, mask, gate)
    assert (found[:, 1] == 63).any(), "some sum was to saturate"


def test_a_histogram_gives_the_sums_of_its_frames():
    rng = np.random.default_rng(7)
    tables = random_tables(7)
    frames = rng.integers(0, 16, (60, 30))
    counts = np.stack([np.bincount(codes, minlength=16) for codes in frames.T])
    offsets = rng.integers(-5, 6, 30)
    expected = reduce_codes(frames, tables, offsets=offsets)
    assert (reduce_histogram(counts, tables, offsets=offsets) == expected).all()


def test_offsets_and_masks_are_not_needed():
    rng = np.random.default_rng(9)
    tables = random_tables(9)
    frames, none = rng.integers(0, 16, (20, 5)), np.zeros(5, int)
    expected = by_hand(frames, tables, none, none, (FIRST, LAST))
    assert reduce_codes(frames, tables).tolist() == expected


def test_the_hash_tells_tables_apart():
    tables = random_tables(0)
    other = tables.entries.copy()
    other[1, 5] ^= 1
    assert random_tables(0).hash == tables.hash
    hashes = {
        tables.hash,
        ReductionTables(other, tables.widths, FIRST, LAST).hash,
        ReductionTables(tables.entries, (10, 6, 9), FIRST, LAST).hash,
        ReductionTables(tables.entries, tables.widths, FIRST, LAST + 1).hash,
    }
    assert len(hashes) == 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"entries": np.zeros((3, 15), int)}, "15 codes: must be a power of 2"),
        ({"entries": np.zeros((33, 16), int)}, r"shape \(33, 16\)"),
        ({"entries": np.full((3, 16), -1)}, "from -1 to -1"),
        ({"entries": np.ones((3, 16), int)}, "a code outside the range from 1 to 12"),
        ({"widths": (10, 6)}, r"widths = \(10, 6\)"),
        ({"widths": (10, 6, 33)}, "33"),
        ({"last": 16}, "last = 16"),
    ],
)
def test_invalid_tables_are_refused(change, message):
    tables = random_tables(0)
    given = {"entries": tables.entries, "widths": tables.widths, "first": FIRST, "last": LAST}
    with pytest.raises(ProtocolError, match=message):
        ReductionTables(**given | change)


def test_invalid_offsets_and_histograms_are_refused():
    tables = random_tables(0)
    with pytest.raises(ProtocolError, match="offset -12 is out of range: at most 11"):
        reduce_codes(np.zeros((1, 2), int), tables, offsets=[0, -12])
    with pytest.raises(ProtocolError, match="must be 2 whole numbers"):
        reduce_codes(np.zeros((1, 2), int), tables, offsets=[0.5, 0])
    with pytest.raises(ProtocolError, match=r"shape \(2, 15\)"):
        reduce_histogram(np.zeros((2, 15), int), tables)
