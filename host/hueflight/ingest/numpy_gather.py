# SPDX-License-Identifier: Apache-2.0
"""Sums of histograms in NumPy: reference implementation of ``_c/gather.h``, and fallback."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.ingest import SCENE_TILE

Table = NDArray[np.unsignedinteger[Any]]


def group_counts(
    histogram: Table,
    wide: bool,
    rows: int,
    cols: int,
    codes: int,
    group: int,
    leave_first: bool,
    out: NDArray[np.float64],
    /,
) -> None:
    """Count photons by tiles of pixels and groups of codes.

    Parameters
    ----------
    histogram : numpy.ndarray, uint16 or (if `wide`) uint32, shape (row, col, code)
        Counts.
    wide : bool
        Whether the counts have 32 bits.
    rows, cols, codes : int
        Shape of `histogram`.
    group : int
        Codes in a group.
    leave_first : bool
        Whether code 0 means that there was no photon, so that it is left out.
    out : numpy.ndarray, float64, shape (tile row, tile col, group)
        Receives the counts. Tiles at the right and the lower edge may have fewer pixels, and the
        last group fewer codes.
    """
    sums = histogram.astype(np.uint64)
    if leave_first:
        sums[..., 0] = 0
    for axis, (length, size) in enumerate([(rows, SCENE_TILE), (cols, SCENE_TILE), (codes, group)]):
        sums = np.add.reduceat(sums, np.arange(0, length, size), axis=axis)
    out[:] = sums


def gather(
    total: Table,
    total_wide: bool,
    histogram: Table,
    histogram_wide: bool,
    anew: NDArray[np.bool_],
    rows: int,
    cols: int,
    codes: int,
    out: Table,
    out_wide: bool,
    /,
) -> None:
    """Add a histogram to a sum that begins anew in some tiles.

    Parameters
    ----------
    total : numpy.ndarray, uint16 or (if `total_wide`) uint32, shape (row, col, code)
        The sum.
    total_wide : bool
        Whether `total` has counts of 32 bits.
    histogram : numpy.ndarray, uint16 or (if `histogram_wide`) uint32, shape (row, col, code)
        Counts to be added.
    histogram_wide : bool
        Whether `histogram` has counts of 32 bits.
    anew : numpy.ndarray, bool, shape (tile row, tile col)
        Tiles whose sum is `histogram` alone.
    rows, cols, codes : int
        Shape of the tables.
    out : numpy.ndarray, uint16 or (if `out_wide`) uint32, shape (row, col, code)
        Receives the new sum; `total` itself, or an array apart from it, of the same width or wider.
    out_wide : bool
        Whether `out` has counts of 32 bits.
    """
    np.add(total, histogram, out=out, dtype=out.dtype, casting="unsafe")
    pixels = np.repeat(np.repeat(anew, SCENE_TILE, 0), SCENE_TILE, 1)[:rows, :cols]
    out[pixels] = histogram[pixels]
