# SPDX-License-Identifier: Apache-2.0
"""Photons add up while nothing changes, and begin anew where something does."""

from __future__ import annotations

import numpy as np
import pytest

from hueflight.errors import IngestError
from hueflight.ingest import gathered_sum
from hueflight.ingest.gathered_sum import GatheredSum
from hueflight.ingest.scene_change import TILE

FRAMES = 50
SHAPE = (24, 32, 64)
BRIGHT, DIM = 20, 44  # codes at which pulses arrive


def scene(codes: np.ndarray) -> np.ndarray:
    """Mean counts of a histogram, given the code of each pixel's pulse."""
    away = np.arange(SHAPE[2]) - codes[..., None]
    return FRAMES * (0.3 * np.exp(-(away**2) / 8) / np.sqrt(8 * np.pi) + 0.0005)


def drawn(mean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    counts = rng.poisson(mean)
    counts[..., 0] = FRAMES - counts[..., 1:].sum(axis=-1)
    return counts.astype(np.uint16)


def still(code: int = BRIGHT) -> np.ndarray:
    return scene(np.full(SHAPE[:2], code))


def test_what_is_still_adds_up_without_end() -> None:
    """80 histograms of 48 tiles, 18 contrasts at 6 sigma: by chance once in a million runs."""
    rng = np.random.default_rng(1)
    gathered, wanted = GatheredSum(), np.zeros(SHAPE, np.int64)
    for number in range(1, 81):
        histogram = drawn(still(), rng)
        wanted += histogram
        gathered.add(histogram, FRAMES)
        assert not gathered.anew.any()
        assert (gathered.frames == FRAMES * number).all()
    assert np.array_equal(gathered.histogram(), wanted)
    before = gathered.histogram()
    gathered.add(drawn(still(), rng), FRAMES)
    assert np.array_equal(before, wanted)  # what was handed out does not change


def test_what_has_changed_begins_anew_with_the_newest_histogram() -> None:
    rng = np.random.default_rng(2)
    gathered = GatheredSum()
    for _ in range(30):
        gathered.add(drawn(still(), rng), FRAMES)
    codes = np.full(SHAPE[:2], BRIGHT)
    codes[8:12, 16:20] = DIM  # one tile
    newest = drawn(scene(codes), rng)
    gathered.add(newest, FRAMES)
    wanted = np.zeros(SHAPE[:2], bool)
    wanted[8 - TILE : 12 + TILE, 16 - TILE : 20 + TILE] = True  # and its neighbors
    assert np.array_equal(gathered.anew, wanted)
    assert np.array_equal(gathered.histogram()[wanted], newest[wanted])
    assert (gathered.frames == np.where(wanted, FRAMES, 31 * FRAMES)).all()
    for _ in range(9):
        gathered.add(drawn(scene(codes), rng), FRAMES)
    assert (gathered.frames == np.where(wanted, 10, 40) * FRAMES).all()


def test_a_square_that_moves_is_never_smeared() -> None:
    """It moves by its width every three histograms; where it is, nothing older is in the sum."""
    rng = np.random.default_rng(3)
    gathered = GatheredSum()
    for _ in range(20):
        gathered.add(drawn(still(), rng), FRAMES)
    for step in range(6):
        codes = np.full(SHAPE[:2], BRIGHT)
        place = (slice(9, 15), slice(3 + 5 * step, min(9 + 5 * step, 32)))  # on no tile's edge
        codes[place] = DIM
        for since in range(1, 4):
            gathered.add(drawn(scene(codes), rng), FRAMES)
            assert (gathered.frames[place] <= FRAMES * since).all()
            old = gathered.histogram()[place][..., BRIGHT - 6 : BRIGHT + 7]
            assert old.mean() < 0.001 * FRAMES * since + 0.05  # the floor of 0.0005 alone


def test_a_slow_drift_is_noticed_in_the_longer_windows() -> None:
    """It takes 200 histograms for one code: far too slow to be seen from one to the next."""
    rng = np.random.default_rng(4)
    gathered = GatheredSum()
    noticed, most = 0, 0
    for number in range(600):
        gathered.add(drawn(scene(np.full(SHAPE[:2], BRIGHT + number / 200)), rng), FRAMES)
        noticed += bool(gathered.anew.any())
        most = max(most, int(gathered.frames.max()) // FRAMES)
    assert 1 <= noticed < 100
    assert most < 400


@pytest.mark.parametrize("limit", [5, 20])
def test_a_limit_keeps_the_newest_half_to_all_of_it(limit: int) -> None:
    rng = np.random.default_rng(5)
    gathered = GatheredSum(limit_frames=limit * FRAMES)
    sums = [np.zeros(SHAPE, np.int64)]
    for number in range(1, 3 * limit):
        histogram = drawn(still(), rng)
        sums.append(sums[-1] + histogram)
        gathered.add(histogram, FRAMES)
        kept = int(gathered.frames[0, 0]) // FRAMES
        assert (gathered.frames == kept * FRAMES).all()
        assert min(number, limit // 2) <= kept <= limit
        assert np.array_equal(gathered.histogram(), sums[-1] - sums[-1 - kept])


def test_with_a_limit_what_has_changed_begins_anew_too() -> None:
    rng = np.random.default_rng(6)
    gathered = GatheredSum(limit_frames=20 * FRAMES)
    for _ in range(13):
        gathered.add(drawn(still(), rng), FRAMES)
    newest = drawn(still(DIM), rng)
    gathered.add(newest, FRAMES)
    assert np.array_equal(gathered.histogram(), newest)
    total = newest.astype(np.int64)
    for _ in range(9):
        histogram = drawn(still(DIM), rng)
        total += histogram
        gathered.add(histogram, FRAMES)
        assert (gathered.frames == FRAMES * (total.sum(axis=-1)[0, 0] // FRAMES)).all()
        assert np.array_equal(gathered.histogram(), total)


def test_counters_grow_and_begin_anew_before_they_wrap(monkeypatch: pytest.MonkeyPatch) -> None:
    histogram = np.zeros((4, 4, 8), np.uint16)
    histogram[..., 3] = 30_000
    gathered = GatheredSum()
    for number in range(1, 5):
        gathered.add(histogram, 30_000)
        assert (gathered.histogram()[..., 3] == 30_000 * number).all()
    monkeypatch.setattr(gathered_sum, "MOST_FRAMES", 140_000)
    gathered.add(histogram, 30_000)
    assert gathered.anew.all()
    assert (gathered.histogram()[..., 3] == 30_000).all()
    assert (gathered.frames == 30_000).all()


def test_another_size_begins_anew() -> None:
    gathered = GatheredSum()
    gathered.add(np.ones((4, 4, 8), np.uint16), 8)
    gathered.add(np.ones((7, 5, 8), np.uint16), 8)
    assert gathered.frames.shape == (7, 5)
    assert (gathered.frames == 8).all()


def test_errors() -> None:
    with pytest.raises(IngestError, match="limit_frames = 0"):
        GatheredSum(limit_frames=0)
    with pytest.raises(IngestError, match="nothing has been added"):
        GatheredSum().histogram()


def test_what_was_given_out_stays_as_it_is_while_it_is_held() -> None:
    """And no longer: then its memory holds a later sum."""
    gathered = GatheredSum()
    histogram = np.zeros((4, 4, 8), np.uint16)
    histogram[..., 3] = 5
    held, places = [], set()
    for number in range(1, 7):
        gathered.add(histogram, 5)
        held.append(gathered.histogram())
        again = gathered.histogram()  # a second loan of the same sum
        places.add(again.ctypes.data)
        del again
        held = held[-2:]  # as a daemon holds the picture that is shown and the one that is made
        for age, earlier in enumerate(reversed(held)):
            assert (earlier[..., 3] == 5 * (number - age)).all()
    assert len(places) <= 4
    held.clear()
    for _ in range(3):
        gathered.add(histogram, 5)
    assert (gathered.histogram()[..., 3] == 45).all()


def test_memory_of_narrower_counters_is_not_used_again() -> None:
    gathered = GatheredSum()
    histogram = np.zeros((4, 4, 8), np.uint16)
    histogram[..., 3] = 30_000
    held = []
    for number in range(1, 5):
        gathered.add(histogram, 30_000)
        held.append(gathered.histogram())
        assert (held[-1][..., 3] == 30_000 * number).all()
        held = held[-1:]
    assert held[0].dtype == np.uint32
