# SPDX-License-Identifier: Apache-2.0
"""The newest blocks of a run, summed for a live picture."""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Sequence

import numpy as np

from hueflight.acquisition.snapshot import LiveBlock
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.sliding_sum import SlidingSum

PARTS = 10  #: histograms in memory at most, besides their sum


class BlockWindow:
    """Sum of the newest blocks of a run, whose memory does not grow with its length.

    Up to `PARTS` blocks are kept as they are. A longer window is kept as `PARTS` partial sums; it
    moves on by a whole part, so that it holds one tenth less or more than its length. While LEDs
    fire one at a time, the sum is of the step that fires now.

    Parameters
    ----------
    length : int
        Blocks in the sum.

    Attributes
    ----------
    length : int
        Blocks in the sum.
    frames : int
        Frames in the sum, and so behind every pixel.
    """

    def __init__(self, length: int) -> None:
        self.length = length
        self.frames = 0
        self._added = 0  # blocks since the sum began
        self._of_part = -(-length // PARTS)  # blocks
        parts = -(-length // self._of_part)
        # of a window of parts, the newest one is not complete yet
        self._sum = SlidingSum(parts if self._of_part == 1 else parts - 1)
        self._kept: deque[LiveBlock] = deque()  # whose histograms are in the sum
        self._part: Counts | None = None  # sum of the blocks of the part that is not complete
        self._part_blocks = self._part_frames = 0
        self._newest: LiveBlock | None = None
        self._only: Counts | None = None  # the block's own histogram if the length is 1

    @property
    def least(self) -> int:
        """Blocks in the sum at least, once the window is full."""
        return self.length if self._of_part == 1 else (PARTS - 1) * self._of_part

    @property
    def most_waiting(self) -> int:
        """Blocks that may wait to be added; those beyond the window would drop out at once."""
        return min(self.length, PARTS)

    @property
    def frames_by_pixel(self) -> int:
        """Frames behind each pixel, of which all have the same."""
        return self.frames

    @property
    def full(self) -> bool:
        """True if the sum has as many blocks as it can hold."""
        return self._added >= self.least

    @classmethod
    def holding(cls, blocks: int, /) -> BlockWindow:
        """Return a window that holds at least so many blocks once it is full.

        Parameters
        ----------
        blocks : int
            Blocks that it holds at least; beyond ten it may hold a few more.

        Returns
        -------
        BlockWindow
            The window.
        """
        return cls(blocks if blocks <= PARTS else PARTS * -(-blocks // (PARTS - 1)))

    def add(self, block: LiveBlock) -> None:
        """Add a block, and drop the oldest ones if the window is full."""
        if self.length == 1:
            self._added = 1
            self.frames, self._only = block.block.frames, _lent(block)
            return
        if self._newest is not None and _sequence(self._newest) != _sequence(block):
            self.clear()
        self._added += 1
        self._newest = block
        if self._of_part == 1:
            self._kept.append(block)
            if self._sum.add({block.step: block.histogram}, block.block.frames):
                self._kept.popleft().give_back()
            self.frames = self._sum.frames
        else:
            self._add_to_part(block)

    def add_all(self, blocks: Sequence[LiveBlock]) -> None:
        """Add blocks one after another."""
        for block in blocks:
            self.add(block)

    def _add_to_part(self, block: LiveBlock) -> None:
        self._part_blocks += 1
        self._part_frames += block.block.frames
        few = self._part_frames <= np.iinfo(np.uint16).max
        dtype = np.uint16 if few else np.uint32
        counts = block.histogram
        if self._part is None:
            self._part = counts.astype(dtype)
        else:
            part = self._part.astype(dtype, copy=False)
            self._part = np.add(part, counts, out=part, casting="unsafe")
        step = block.step
        block.give_back()
        self.frames = self._sum.frames + self._part_frames
        if self._part_blocks == self._of_part:
            self._sum.add({step: self._part}, self._part_frames)
            self._part, self._part_blocks, self._part_frames = None, 0, 0
            self.frames = self._sum.frames

    def clear(self) -> None:
        """Forget all blocks."""
        self._added = 0
        self.frames, self._only, self._newest = 0, None, None
        self._part, self._part_blocks, self._part_frames = None, 0, 0
        self._sum.clear()
        while self._kept:
            self._kept.popleft().give_back()

    def histogram(self) -> Counts:
        """Return the sum in an array that later blocks do not change."""
        if self._only is not None:
            return self._only
        assert self._newest is not None
        complete = self._sum.sums.get(self._newest.step)
        if self._part is None:
            assert complete is not None
            return complete.copy()
        if complete is None:
            return self._part.copy()
        dtype = np.uint16 if self.frames <= np.iinfo(np.uint16).max else np.uint32
        return np.add(complete, self._part, dtype=dtype, casting="unsafe")


def _lent(block: LiveBlock) -> Counts:
    """The block's histogram; its memory is given back once nothing refers to this array."""
    histogram = block.histogram.view()
    weakref.finalize(histogram, block.give_back)
    return histogram


def _sequence(block: LiveBlock) -> tuple[int, int]:
    """Run and step, which all blocks of a sum have in common."""
    return block.run, block.step
