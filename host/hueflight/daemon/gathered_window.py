# SPDX-License-Identifier: Apache-2.0
"""Blocks of a run, summed for a live picture for as long as nothing changes in the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.snapshot import LiveBlock
from hueflight.daemon.block_window import PARTS
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.gathered_sum import GatheredSum
from hueflight.model.instrument import Instrument


class GatheredWindow:
    """Sum of blocks in which photons add up where nothing changes.

    Everything begins anew when the LEDs fire in another way. See
    `hueflight.ingest.gathered_sum.GatheredSum`.

    Parameters
    ----------
    instrument : Instrument
        Instrument of the histograms.
    integration_s : float
        Longest time in the sum, in seconds; infinite for no limit.
    rate_hz : float
        Frames per second to expect.

    Attributes
    ----------
    most_waiting : int
        Blocks that may wait to be added.
    least : int
        Blocks in the sum at least.
    full : bool
        True: pixels begin anew by themselves.
    frames : int
        Frames behind the pixel that has most.
    """

    most_waiting = PARTS
    least = 1
    full = True

    def __init__(self, instrument: Instrument, integration_s: float, rate_hz: float) -> None:
        limit = None if math.isinf(integration_s) else max(1, round(integration_s * rate_hz))
        self._sum = GatheredSum(limit_frames=limit, reports_empty=instrument.sensor.reports_empty)
        self._lit: tuple[str, int] | None = None
        self._room: Counts | None = None  # used again: new memory takes longer than the sum itself
        self.frames = 0

    @property
    def frames_by_pixel(self) -> NDArray[np.int64]:
        """Frames behind each pixel, shape (row, col)."""
        return self._sum.frames

    def add(self, block: LiveBlock) -> None:
        """Add a block, and give it back."""
        self.add_all([block])

    def add_all(self, blocks: Sequence[LiveBlock]) -> None:
        """Add blocks, and give them back.

        Those of the same light are first added to each other, which takes much less time than to
        look for changes with each: where pictures are late, they do not become later by it.
        """
        for lit, alike in groupby(blocks, key=lambda block: (block.kind, block.step)):
            if self._lit != lit:
                self.clear()
            self._lit = lit
            together = list(alike)
            some = [block for block in together if block.block.frames]
            if some:
                frames = sum(block.block.frames for block in some)
                self._sum.add(self._summed([block.histogram for block in some], frames), frames)
                self.frames = int(self._sum.frames.max())
            for block in together:
                block.give_back()

    def clear(self) -> None:
        """Begin anew everywhere."""
        self._sum.clear()
        self._lit, self.frames = None, 0

    def histogram(self) -> Counts:
        """Return the sum in an array that later blocks do not change."""
        return self._sum.histogram()

    def _summed(self, histograms: Sequence[Counts], frames: int) -> Counts:
        """Sum of histograms, of so many frames together; a single one as it is."""
        first, *others = histograms
        if not others:
            return first
        dtype = np.uint16 if frames <= np.iinfo(np.uint16).max else np.uint32
        if self._room is None or (self._room.shape, self._room.dtype) != (first.shape, dtype):
            self._room = np.empty(first.shape, dtype)
        np.add(first, others[0], out=self._room, dtype=dtype, casting="unsafe")
        for histogram in others[1:]:
            np.add(self._room, histogram, out=self._room, casting="unsafe")
        return self._room
