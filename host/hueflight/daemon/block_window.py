"""The newest blocks of a run, summed for a live picture."""

from __future__ import annotations

import weakref
from collections import deque

from hueflight.acquisition.snapshot import LiveBlock
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.sliding_sum import SlidingSum


class BlockWindow:
    """Sum of the newest blocks of a run, which gives each block's memory back when it can.

    While LEDs fire one at a time, the sum is of the step that fires now.

    Parameters
    ----------
    length : int
        Blocks in the sum.
    """

    def __init__(self, length: int) -> None:
        self.length = length
        self.frames = 0  #: in the sum
        self._blocks: deque[LiveBlock] = deque()
        self._sum = SlidingSum(length)
        self._only: Counts | None = None  # the block's own histogram if the length is 1

    def add(self, block: LiveBlock) -> None:
        """Add a block, and drop the oldest one if the window is full."""
        if self.length == 1:
            self.frames, self._only = block.block.frames, _lent(block)
            return
        if self._blocks and _sequence(self._blocks[-1]) != _sequence(block):
            self.clear()
        self._blocks.append(block)
        if self._sum.add({_step(block): _histogram(block)}, block.block.frames):
            self._blocks.popleft().give_back()
        self.frames = self._sum.frames

    def clear(self) -> None:
        """Forget all blocks."""
        self.frames, self._only = 0, None
        self._sum.clear()
        while self._blocks:
            self._blocks.popleft().give_back()

    def histogram(self) -> Counts:
        """Return the sum in an array that later blocks do not change."""
        if self._only is not None:
            return self._only
        return self._sum.sums[_step(self._blocks[-1])].copy()


def _lent(block: LiveBlock) -> Counts:
    """The block's histogram; its memory is given back once nothing refers to this array."""
    histogram = _histogram(block).view()
    weakref.finalize(histogram, block.give_back)
    return histogram


def _histogram(block: LiveBlock) -> Counts:
    return block.block.counts[_step(block)]


def _sequence(block: LiveBlock) -> tuple[int, int]:
    """Run and step, which all blocks of a sum have in common."""
    return block.run, _step(block)


def _step(block: LiveBlock) -> int:
    """The illuminator's step at the end of the block."""
    return max(block.block.counts)
