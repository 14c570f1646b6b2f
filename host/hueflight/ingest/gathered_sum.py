# SPDX-License-Identifier: Apache-2.0
"""Sum of the histograms of a stream that begins anew wherever the scene changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import IngestError
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.scene_change import SIGMA, TILE, changed_tiles, grown, tile_counts

LONGER = 8  #: times as many histograms in each following window of the test
Value = TypeVar("Value", bound=np.generic)  # of a tile
MOST_FRAMES = int(np.iinfo(np.uint32).max)  #: then a pixel begins anew: its counters are full


@dataclass(eq=False)
class _Window:
    """The latest counts of every tile, as one of the lengths over which changes are looked for."""

    length: int
    counts: NDArray[np.float64]
    frames: NDArray[np.float64]
    entries: int = 0

    def clear(self, where: NDArray[np.bool_] | slice = slice(None)) -> None:
        self.counts[where] = 0
        self.frames[where] = 0


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
    sigma : float
        Standard deviations that make a change.

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
        sigma: float = SIGMA,
    ) -> None:
        if limit_frames is not None and limit_frames < 1:
            raise IngestError(f"limit_frames = {limit_frames}: must be 1 or more")
        self._limit = limit_frames
        self._reports_empty = reports_empty
        self._sigma = sigma
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.frames: NDArray[np.int64] = np.zeros((0, 0), np.int64)
        self.anew: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self._total: Counts | None = None
        self._lent = False  # whether somebody holds the array of the sum, which then stays as it is
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
        histogram : array of unsigned int, shape (row, col, code)
            Counts, at most one for each frame and code.
        frames : int
            Frames behind it, 1 or more.
        """
        counts = tile_counts(histogram, frames, reports_empty=self._reports_empty)
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
        self._total = self._added(self._total, histogram, most, in_place=not self._lent)
        self._lent = False
        if self._limit is not None:
            self._young_frames += frames
            self._young = self._added(self._young, histogram, self._young_frames, in_place=True)

    def histogram(self) -> Counts:
        """Return the sum in an array that later histograms do not change.

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
        self._lent = True
        return self._total

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
            window.entries = 0
        self._total, self._young = self._young, np.zeros_like(self._young)
        self._lent = False
        self._young_frames = 0

    def _changed(self, counts: NDArray[np.float64], frames: int) -> NDArray[np.bool_]:
        """Tiles that changed, by the newest histogram and each longer window that it completes."""
        newest = np.full(self._tile_frames.shape, float(frames))
        changed = grown(
            changed_tiles(counts, newest, self._tiles, self._tile_frames, sigma=self._sigma)
        )
        self._entries += 1
        if self._entries == LONGER ** (len(self._windows) + 1):
            length = self._entries
            self._windows.append(
                _Window(length, np.zeros(counts.shape), np.zeros(counts.shape[:2]))
            )
        for window in self._windows:
            window.counts += counts
            window.frames += frames
            window.entries += 1
            if window.entries < window.length:
                continue
            changed |= changed_tiles(
                window.counts,
                window.frames,
                self._tiles + counts - window.counts,
                self._tile_frames + frames - window.frames,
                sigma=self._sigma,
            )
            window.clear()
            window.entries = 0
        return changed

    def _add_to_tiles(
        self, counts: NDArray[np.float64], frames: int, changed: NDArray[np.bool_]
    ) -> None:
        self._tiles[changed] = 0
        self._tile_frames[changed] = 0
        for window in self._windows:
            window.clear(changed)
        self._tiles += counts
        self._tile_frames += frames

    def _pixels(self, tiles: NDArray[Value]) -> NDArray[Value]:
        """Values of tiles, for each of their pixels."""
        rows, cols = self._shape
        return np.repeat(np.repeat(tiles, TILE, 0), TILE, 1)[:rows, :cols]

    def _added(
        self, total: Counts | None, histogram: Counts, most: int, *, in_place: bool
    ) -> Counts:
        """`total` with the histogram added; pixels that begin anew hold it alone."""
        assert total is not None
        few = most <= np.iinfo(total.dtype).max
        dtype = total.dtype if few else np.dtype(np.uint32)
        out = total if in_place and few else np.empty(total.shape, dtype)
        np.add(total, histogram, out=out, dtype=dtype, casting="unsafe")
        out[self.anew] = histogram[self.anew]
        return out
