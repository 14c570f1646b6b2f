# SPDX-License-Identifier: Apache-2.0
"""Sums of the latest histograms of a stream, kept up to date as it moves on."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from hueflight.ingest.accumulator import Counts


class SlidingSum:
    """Sum of the latest histograms: each one is added once and subtracted once.

    Parameters
    ----------
    length : int
        Number of entries in the sum.
    dtype : data type, optional
        Type of the sums. By default uint16 while the frames in the sum are few enough for it, and
        uint32 beyond, which needs histograms that hold at most one photon per frame and code.

    Attributes
    ----------
    frames : int
        Frames in the sum.
    sums : dict of int to array, shape (row, col, code)
        Sum for each step of the illuminator that occurs. These arrays change with the next `add`.
    """

    def __init__(self, length: int, /, *, dtype: type[np.unsignedinteger] | None = None) -> None:
        self._length = length
        self._dtype = dtype
        self._entries: deque[tuple[int, Mapping[int, Counts]]] = deque()
        self.clear()

    def clear(self) -> None:
        """Forget all entries."""
        self._entries.clear()
        self.frames = 0
        self.sums: dict[int, Counts] = {}

    def add(self, histograms: Mapping[int, Counts], frames: int, /) -> bool:
        """Add an entry, and subtract the oldest one if the sum is full.

        The histograms are read again when the entry is subtracted; until then they must not change.

        Parameters
        ----------
        histograms : mapping of int to array, shape (row, col, code)
            Counts by step of the illuminator.
        frames : int
            Frames behind them.

        Returns
        -------
        bool
            True if the oldest entry was subtracted, so that it is no longer needed.
        """
        full = len(self._entries) == self._length
        if full:
            old_frames, old = self._entries.popleft()
            self.frames -= old_frames
            for step, counts in old.items():
                np.subtract(self.sums[step], counts, out=self.sums[step])
        self._entries.append((frames, histograms))
        self.frames += frames
        dtype = self._dtype
        if dtype is None:
            dtype = np.uint16 if self.frames <= np.iinfo(np.uint16).max else np.uint32
        for step, counts in histograms.items():
            if step in self.sums:
                total = self.sums[step].astype(dtype, copy=False)
                self.sums[step] = np.add(total, counts, out=total)
            else:
                self.sums[step] = counts.astype(dtype)
        kept = {step for _, entry in self._entries for step in entry}
        self.sums = {step: self.sums[step] for step in sorted(kept)}
        return full
