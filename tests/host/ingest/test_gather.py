# SPDX-License-Identifier: Apache-2.0
"""Sums over histograms: both implementations against plain loops over pixels."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hueflight.backend.ingest import SCENE_TILE
from hueflight.ingest import kernels

KERNELS = kernels.available()
SHAPES = st.tuples(st.integers(1, 11), st.integers(1, 11), st.integers(1, 70))
WIDTHS = [np.uint16, np.uint32]


def tiles_of(shape: tuple[int, int, int]) -> tuple[int, int]:
    return -(-shape[0] // SCENE_TILE), -(-shape[1] // SCENE_TILE)


def drawn(rng: np.random.Generator, shape: tuple[int, ...], dtype: Any) -> Any:
    """Counts over the whole range of their type, so that sums wrap where they may."""
    return rng.integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("dtype", WIDTHS)
@given(shape=SHAPES, group=st.integers(1, 80), leave_first=st.booleans(), seed=st.integers(0, 99))
def test_groups_of_codes_in_tiles(
    name: str, dtype: Any, shape: tuple[int, int, int], group: int, leave_first: bool, seed: int
) -> None:
    counts = drawn(np.random.default_rng(seed), shape, dtype)
    groups = -(-shape[2] // group)
    out = np.full((*tiles_of(shape), groups), np.nan)
    KERNELS[name].group_counts(counts, dtype == np.uint32, *shape, group, leave_first, out)
    for row, col, index in np.ndindex(out.shape):
        tile = counts[SCENE_TILE * row :, SCENE_TILE * col :][:SCENE_TILE, :SCENE_TILE]
        first = index * group + (leave_first and index == 0)
        assert out[row, col, index] == tile[..., first : (index + 1) * group].sum(dtype=np.uint64)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize(
    ("old", "new", "word"),
    [widths for widths in product(WIDTHS, repeat=3) if widths[0] is not np.uint32
     or widths[2] is np.uint32],
)  # fmt: skip
@given(shape=SHAPES, in_place=st.booleans(), seed=st.integers(0, 99))
def test_a_histogram_is_added_but_where_tiles_begin_anew(
    name: str, old: Any, new: Any, word: Any, shape: tuple[int, int, int], in_place: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    total, histogram = drawn(rng, shape, old), drawn(rng, shape, new)
    anew = rng.random(tiles_of(shape)) < 0.3
    before = total.copy()
    out = total if in_place and old is word else np.zeros(shape, word)
    KERNELS[name].gather(
        *(total, old is np.uint32, histogram, new is np.uint32, anew, *shape),
        *(out, word is np.uint32),
    )
    for row, col in np.ndindex(shape[:2]):
        wanted = histogram[row, col].astype(word)
        if not anew[row // SCENE_TILE, col // SCENE_TILE]:
            wanted = wanted + before[row, col].astype(word)
        assert np.array_equal(out[row, col], wanted)


@pytest.mark.skipif("c" not in KERNELS, reason="the kernels are not compiled here")
def test_buffers_that_are_too_small_are_refused() -> None:
    kernel = KERNELS["c"]
    counts, anew = np.zeros((5, 4, 8), np.uint16), np.zeros((2, 1), bool)
    with pytest.raises(ValueError, match="out has 24 bytes, fewer than the 32 it needs"):
        kernel.group_counts(counts, False, 5, 4, 8, 4, False, np.zeros(3))
    with pytest.raises(ValueError, match="group_counts: argument out of range"):
        kernel.group_counts(counts, False, 5, 4, 8, 0, False, np.zeros(4))
    with pytest.raises(ValueError, match="histogram has 320 bytes, fewer than the 640 it needs"):
        kernel.gather(counts, False, counts, True, anew, 5, 4, 8, counts, False)
    with pytest.raises(ValueError, match="anew has 2 bytes, fewer than the 4 it needs"):
        kernel.gather(counts, False, counts, False, anew, 5, 8, 4, counts, False)
    with pytest.raises(ValueError, match="gather: argument out of range"):
        kernel.gather(counts, True, counts, False, anew, 5, 4, 8, counts, False)
