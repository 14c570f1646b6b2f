# SPDX-License-Identifier: Apache-2.0
"""Sum of the histograms of a stream that begins anew wherever the scene changes."""

from __future__ import annotations

import threading
import weakref
from collections import Counter
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import IngestError
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.kernels import choose
from hueflight.ingest.scene_change import TILE, changed_tiles, grown, tile_counts

MOST_SPARE = 2  #: arrays that wait to be used again: new memory takes longer than the sum itself
LONGER = 8  #: times as many histograms in each following window of the test
Value = TypeVar("Value", bound=np.generic)  # of a tile
MOST_FRAMES = int(np.iinfo(np.uint32).max)  #: then a pixel begins anew: its counters are full


@dataclass(eq=False)
class _Window:
    """The latest counts of every tile, as one of the lengths over which changes are looked for."""

    length: int
    counts: NDArray[np.float64]
    frames: int = 0
    entries: int = 0

    def clear(self) -> None:
        self.counts[:] = 0
        self.frames = self.entries = 0


class GatheredSum:
    """Sum of histograms in which photons add up as long as nothing changes.

    The newest histogram is compared with the sum of all before it (`changed_tiles`), and so are,
    each time they are complete, the latest 8, 64, 512, … histograms: the longer ones tell slower
    and smaller changes. Tiles that have changed, and after a sudden change their neighbors, begin
    anew with the newest histogram.

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
        self._tiles = np.zeros(0)
        self._tile_frames = np.zeros(0)
        self._windows: list[_Window] = []
        self._entries = 0

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
        changed = self._changed(counts, frames)
        changed |= self._tile_frames + frames > MOST_FRAMES
        self._add_to_tiles(counts, frames, changed)
        self.anew = self._pixels(changed)
        self.frames = self._pixels(self._tile_frames.astype(np.int64))
        most = int(self._tile_frames.max())
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
        self._tiles, self._tile_frames = np.zeros(counts.shape), np.zeros(counts.shape[:2])

    def _forget_older(self) -> None:
        """Keep only the latest half; comparisons go on with what they know."""
        assert self._young is not None
        young = np.minimum(self._tile_frames, self._young_frames)
        scale = np.divide(young, self._tile_frames, out=np.zeros(young.shape), where=young > 0)
        self._tiles *= scale[..., None]
        self._tile_frames = young
        for window in self._windows:  # they may hold more than is left
            window.clear()
        self._total, self._young = self._young, np.zeros_like(self._young)
        self._young_frames = 0

    def _changed(self, counts: NDArray[np.float64], frames: int) -> NDArray[np.bool_]:
        """Tiles that changed, by the newest histogram and each longer window that it completes."""
        newest = np.full(self._tile_frames.shape, float(frames))
        changed = grown(changed_tiles(counts, newest, self._tiles, self._tile_frames))
        self._entries += 1
        if self._entries == LONGER ** (len(self._windows) + 1):
            length = self._entries
            self._windows.append(_Window(length, np.zeros(counts.shape)))
        for window in self._windows:
            window.counts += counts
            window.frames += frames
            window.entries += 1
            if window.entries < window.length:
                continue
            # tiles that began anew within the window have no earlier frames, and are not compared
            changed |= changed_tiles(
                window.counts,
                np.full(newest.shape, float(window.frames)),
                self._tiles + counts - window.counts,
                self._tile_frames + frames - window.frames,
            )
            window.clear()
        return changed

    def _add_to_tiles(
        self, counts: NDArray[np.float64], frames: int, changed: NDArray[np.bool_]
    ) -> None:
        self._tiles[changed] = 0
        self._tile_frames[changed] = 0
        self._tiles += counts
        self._tile_frames += frames

    def _pixels(self, tiles: NDArray[Value]) -> NDArray[Value]:
        """Values of tiles, for each of their pixels."""
        rows, cols = self._shape
        return np.repeat(np.repeat(tiles, TILE, 0), TILE, 1)[:rows, :cols]

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
