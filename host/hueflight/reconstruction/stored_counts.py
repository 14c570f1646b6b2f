# SPDX-License-Identifier: Apache-2.0
"""Counts that stay on disk and are read in blocks of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hueflight.model.histograms import as_native
from hueflight.model.time_bins import TimeBins

BLOCK_BYTES = 32_000_000  #: of counts that are read together


class StoredArray(Protocol):
    """An array that is read by slices: of Zarr, HDF5 or dask, or a memory-mapped file.

    Attributes
    ----------
    shape : tuple of int
        Its shape.
    dtype : dtype
        Type of its elements.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        ...

    @property
    def dtype(self) -> Any:
        """Type of its elements."""
        ...

    def __getitem__(self, rows: slice, /) -> Any:
        """Return some of its rows."""
        ...


def is_stored(histogram: object) -> TypeGuard[StoredArray]:
    """Return whether an array is read from disk by slices.

    Parameters
    ----------
    histogram : object
        What a user gave.

    Returns
    -------
    bool
        True for memory-mapped arrays and for those that are kept in chunks.
    """
    if isinstance(histogram, np.ndarray):
        return isinstance(histogram, np.memmap)
    return all(hasattr(histogram, name) for name in ("shape", "dtype", "chunks", "__getitem__"))


@dataclass(frozen=True, eq=False)
class StoredCounts:
    """Counts of a histogram on disk in time order.

    Attributes
    ----------
    source : StoredArray, shape (row, col, code)
        The histogram.
    bins : TimeBins
        Bins of the counts.
    """

    source: StoredArray
    bins: TimeBins

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of rows, columns and bins."""
        return self.source.shape[0], self.source.shape[1], self.bins.count

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the counts."""
        return np.dtype(self.source.dtype)

    def reshape(self, *_: int) -> StoredCounts:
        """Return the same counts: pixels are numbered row by row in any case."""
        return self

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Read all counts (row, col, bin)."""
        return np.asarray(self.bins.in_time_order(self._read(slice(None))), dtype)

    def __getitem__(self, wanted: NDArray[np.int64]) -> NDArray[Any]:
        """Read some pixels (pixel, bin), whose numbers rise."""
        parts = [counts[here] for _, counts, here in self.pixels(wanted)]
        return np.concatenate(parts) if parts else np.empty((0, self.shape[2]), self.dtype)

    @property
    def block_rows(self) -> int:
        """Rows that are read together: about `BLOCK_BYTES`, whole chunks of the store."""
        rows, cols, codes = self.source.shape
        fit = max(1, BLOCK_BYTES // max(1, cols * codes * self.dtype.itemsize))
        chunks = getattr(self.source, "chunks", None)
        if chunks:
            chunk = int(np.max(chunks[0]))
            fit = max(1, fit // chunk) * chunk
        return min(rows, fit)

    def _read(self, rows: slice) -> NDArray[Any]:
        return as_native(self.source[rows])

    def blocks(self) -> Iterator[tuple[slice, NDArray[Any]]]:
        """Read the histogram block by block.

        Yields
        ------
        tuple of slice and ndarray, shape (row, col, code)
            Rows, and their counts by code.
        """
        rows, step = self.source.shape[0], self.block_rows
        for start in range(0, rows, step):
            some = slice(start, min(start + step, rows))
            yield some, self._read(some)

    def pixels(
        self, wanted: NDArray[np.int64]
    ) -> Iterator[tuple[slice, NDArray[Any], NDArray[np.int64]]]:
        """Read the blocks that hold some pixels.

        Parameters
        ----------
        wanted : ndarray of int, shape (pixel,)
            Numbers of pixels, rising.

        Yields
        ------
        tuple of slice, ndarray and ndarray
            Which of the pixels a block holds, its counts (pixel, bin), and where in it they are.
        """
        rows, cols, bins = self.shape
        step = self.block_rows
        for start in range(0, rows, step):
            stop = min(start + step, rows)
            first, last = np.searchsorted(wanted, [start * cols, stop * cols])
            if first == last:
                continue
            light = self.bins.in_time_order(self._read(slice(start, stop)))
            here = wanted[first:last] - start * cols
            yield slice(first, last), light.reshape(-1, bins), here
