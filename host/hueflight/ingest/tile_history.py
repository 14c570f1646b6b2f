# SPDX-License-Identifier: Apache-2.0
"""What the tiles of a stream of pictures have added up to, to tell where the scene changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.ingest.scene_change import Compare, changed_tiles, compare_counts, grown

LONGER = 8  #: times as many pictures in each following window of the test


@dataclass(eq=False)
class _Window:
    """The latest values of every tile, as one of the lengths over which changes are looked for."""

    length: int
    values: NDArray[np.float64]
    frames: NDArray[np.float64]
    entries: int = 0

    def clear(self) -> None:
        self.values[:] = 0
        self.frames[:] = 0
        self.entries = 0


class TileHistory:
    """Sums over each tile, which begin anew where the newest picture differs from all before it.

    The newest picture is compared with all before it, and so are, each time they are complete, the
    latest 8, 64, 512, … pictures: the longer ones tell slower and smaller changes. Tiles that have
    changed, and after a sudden change their neighbors, begin anew with the newest picture.

    Parameters
    ----------
    shape : tuple of int
        Tile rows, tile columns, and values of a tile.
    compare : callable
        Significance of changes; see `hueflight.ingest.scene_change.changed_tiles`.

    Attributes
    ----------
    frames : array of float64, shape (tile row, tile col)
        Frames behind each tile.
    """

    def __init__(self, shape: tuple[int, int, int], /, compare: Compare = compare_counts) -> None:
        self._compare = compare
        self._values = np.zeros(shape)
        self.frames: NDArray[np.float64] = np.zeros(shape[:2])
        self._windows: list[_Window] = []
        self._entries = 0

    def add(
        self,
        values: NDArray[np.float64],
        frames: NDArray[np.float64],
        begin: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
        /,
    ) -> NDArray[np.bool_]:
        """Add a picture.

        Parameters
        ----------
        values : array of float64, shape (tile row, tile col, value)
            Values of the picture.
        frames : array of float64, shape (tile row, tile col)
            Frames behind them; 0 in tiles of which the picture knows nothing.
        begin : callable
            Returns which tiles begin anew in any case, from the frames that they would have.

        Returns
        -------
        array of bool, shape (tile row, tile col)
            Tiles that began anew with this picture.
        """
        changed = self._changed(values, frames) | begin(self.frames + frames)
        self._values[changed] = 0
        self.frames[changed] = 0
        self._values += values
        self.frames += frames
        return changed

    def keep(self, frames: NDArray[np.float64] | int, /) -> None:
        """Go on as if the tiles had been gathered over their latest frames only.

        Parameters
        ----------
        frames : int or array of float64, shape (tile row, tile col)
            Frames to keep of each tile, at most.
        """
        kept = np.minimum(self.frames, frames)
        scale = np.divide(kept, self.frames, out=np.zeros(kept.shape), where=kept > 0)
        self._values *= scale[..., None]
        self.frames = kept
        for window in self._windows:  # they may hold more than is left
            window.clear()

    def _changed(
        self, values: NDArray[np.float64], frames: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Tiles that changed, by the newest picture and each longer window that it completes."""
        changed = grown(
            changed_tiles(values, frames, self._values, self.frames, compare=self._compare)
        )
        self._entries += 1
        if self._entries == LONGER ** (len(self._windows) + 1):
            nothing = np.zeros(values.shape), np.zeros(frames.shape)
            self._windows.append(_Window(self._entries, *nothing))
        for window in self._windows:
            window.values += values
            window.frames += frames
            window.entries += 1
            if window.entries < window.length:
                continue
            # tiles that began anew within the window have no earlier frames, and are not compared
            changed |= changed_tiles(
                window.values,
                window.frames,
                self._values + values - window.values,
                self.frames + frames - window.frames,
                compare=self._compare,
            )
            window.clear()
        return changed
