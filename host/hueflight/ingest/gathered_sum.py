# SPDX-License-Identifier: Apache-2.0
"""Sum of the histograms of a stream that begins anew wherever the scene changes."""

from __future__ import annotations

import threading
import weakref
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import IngestError
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.kernels import choose
from hueflight.ingest.scene_change import of_pixels, tile_counts
from hueflight.ingest.tile_history import TileHistory

MOST_SPARE = 2  #: arrays that wait to be used again: new memory takes longer than the sum itself
MOST_FRAMES = int(np.iinfo(np.uint32).max)  #: then a pixel begins anew: its counters are full


class GatheredSum:
    """Sum of histograms in which photons add up as long as nothing changes.

    Tiles begin anew where the newest histograms differ from all before them; see
    `hueflight.ingest.tile_history.TileHistory`.

    Parameters
    ----------
    limit_frames : int, optional
        Most frames in the sum. It then holds from half as many up to all of them. By default there
        is no limit but that of the counters, `MOST_FRAMES`.
    reports_empty : bool
        True if code 0 means that there was no photon.

    Attributes
    ----------
    frames : array of int, shape (row, col)
        Frames behind each pixel of the sum.
    anew : array of bool, shape (row, col)
        Pixels that began anew with the latest histogram.

    Raises
    ------
    IngestError
        If `limit_frames` is below 1.
    """

    def __init__(
        self,
        *,
        limit_frames: int | None = None,
        reports_empty: bool = True,
    ) -> None:
        if limit_frames is not None and limit_frames < 1:
            raise IngestError(f"limit_frames = {limit_frames}: must be 1 or more")
        self._limit = limit_frames
        self._reports_empty = reports_empty
        self._lock = threading.RLock()  # of loans and spare arrays; a loan may end in any thread
        self._loans: Counter[int] = Counter()
        self._spare: list[Counts] = []
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.frames: NDArray[np.int64] = np.zeros((0, 0), np.int64)
        self.anew: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self._total: Counts | None = None
        self._young: Counts | None = None  # the latest half, where there is a limit
        self._young_frames = 0
        self._history = TileHistory((0, 0, 0))

    def add(self, histogram: Counts, frames: int, /) -> None:
        """Add a histogram, which is not needed any more afterwards.

        Parameters
        ----------
        histogram : array of uint16 or uint32, shape (row, col, code)
            Counts, at most one for each frame and code.
        frames : int
            Frames behind it, 1 or more.
        """
        counts = tile_counts(histogram, reports_empty=self._reports_empty)
        if self._total is None or self._total.shape != histogram.shape:
            self._begin(histogram, counts)
        elif self._limit is not None and 2 * (self._young_frames + frames) > self._limit:
            self._forget_older()
        history = self._history
        newest = np.full(history.frames.shape, float(frames))
        changed = history.add(counts, newest, lambda together: together > MOST_FRAMES)
        self.anew = of_pixels(changed, *self._shape)
        self.frames = of_pixels(history.frames.astype(np.int64), *self._shape)
        most = int(history.frames.max())
        histogram = np.ascontiguousarray(histogram)
        self._total = self._added(self._total, histogram, changed, most)
        if self._limit is not None:
            self._young_frames += frames
            self._young = self._added(self._young, histogram, changed, self._young_frames)

    def histogram(self) -> Counts:
        """Return the sum in an array that later histograms do not change.

        Its memory is used again once nothing refers to this array any more; a view of it does not
        keep it.

        Returns
        -------
        array of uint16 or uint32, shape (row, col, code)
            Counts; `frames` has the frames behind each pixel.

        Raises
        ------
        IngestError
            If nothing has been added.
        """
        if self._total is None:
            raise IngestError("nothing has been added to the sum: add a histogram first")
        total = self._total
        lent = total.view()
        with self._lock:
            self._loans[id(total)] += 1
        weakref.finalize(lent, self._end_loan, total).atexit = False
        return lent

    def _end_loan(self, array: Counts) -> None:
        with self._lock:
            self._loans[id(array)] -= 1
            if not self._loans[id(array)]:
                del self._loans[id(array)]
                if array is not self._total and array is not self._young:
                    self._spare = [array, *self._spare][:MOST_SPARE]

    def _begin(self, histogram: Counts, counts: NDArray[np.float64]) -> None:
        self.clear()
        self._shape = histogram.shape[:2]
        self._total = np.zeros(histogram.shape, np.uint16)
        if self._limit is not None:
            self._young = np.zeros(histogram.shape, np.uint16)
        rows, cols, groups = counts.shape
        self._history = TileHistory((rows, cols, groups))

    def _forget_older(self) -> None:
        """Keep only the latest half; comparisons go on with what they know."""
        assert self._young is not None
        self._history.keep(self._young_frames)
        self._total, self._young = self._young, np.zeros_like(self._young)
        self._young_frames = 0

    def _added(
        self, total: Counts | None, histogram: Counts, changed: NDArray[np.bool_], most: int
    ) -> Counts:
        """`total` with the histogram added; tiles that have changed hold it alone."""
        assert total is not None
        few = most <= np.iinfo(total.dtype).max
        dtype = total.dtype if few else np.dtype(np.uint32)
        with self._lock:
            in_place = few and id(total) not in self._loans
        out = total if in_place else self._empty(total.shape, dtype)
        wide, newer, wider = (part.dtype == np.uint32 for part in (total, histogram, out))
        rows, cols, codes = total.shape
        choose().gather(total, wide, histogram, newer, changed, rows, cols, codes, out, wider)
        return out

    def _empty(self, shape: tuple[int, ...], dtype: np.dtype[np.unsignedinteger]) -> Counts:
        """An array to be filled, of memory that was used before if there is any."""
        with self._lock:
            for place, array in enumerate(self._spare):
                if (array.shape, array.dtype) == (shape, dtype):
                    return self._spare.pop(place)
            self._spare.clear()  # of another size: they will not be needed
        return np.empty(shape, dtype)
