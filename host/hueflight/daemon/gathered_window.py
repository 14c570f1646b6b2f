# SPDX-License-Identifier: Apache-2.0
"""Blocks of a run, summed for a live picture for as long as nothing changes in the scene."""

from __future__ import annotations

import math

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
    length : int
        Blocks that may wait to be added.
    least : int
        Blocks in the sum at least.
    frames : int
        Frames behind the pixel that has most.
    """

    length = PARTS
    least = 1

    def __init__(self, instrument: Instrument, integration_s: float, rate_hz: float) -> None:
        limit = None if math.isinf(integration_s) else max(1, round(integration_s * rate_hz))
        self._sum = GatheredSum(limit_frames=limit, reports_empty=instrument.sensor.reports_empty)
        self._lit: tuple[str, int] | None = None
        self.frames = 0

    @property
    def frames_by_pixel(self) -> NDArray[np.int64]:
        """Frames behind each pixel, shape (row, col)."""
        return self._sum.frames

    def add(self, block: LiveBlock) -> None:
        """Add a block, and give it back."""
        step = max(block.block.counts)
        if self._lit != (block.kind, step):
            self.clear()
        self._lit = block.kind, step
        if block.block.frames:
            self._sum.add(block.block.counts[step], block.block.frames)
            self.frames = int(self._sum.frames.max())
        block.give_back()

    def clear(self) -> None:
        """Begin anew everywhere."""
        self._sum.clear()
        self._lit, self.frames = None, 0

    def histogram(self) -> Counts:
        """Return the sum in an array that later blocks do not change."""
        return self._sum.histogram()
