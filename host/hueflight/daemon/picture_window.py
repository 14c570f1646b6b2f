# SPDX-License-Identifier: Apache-2.0
"""What a live picture is made of: a sum of blocks, of which there is more than one kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.snapshot import LiveBlock
from hueflight.ingest.accumulator import Counts


class PictureWindow(Protocol):
    """Sum of blocks of a run: the newest ones, or all since a pixel has changed."""

    @property
    def most_waiting(self) -> int:
        """Blocks that may wait to be added."""
        ...

    @property
    def least(self) -> int:
        """Blocks in the sum at least, once the window is full."""
        ...

    @property
    def full(self) -> bool:
        """True if the sum has as many blocks as it is to have."""
        ...

    @property
    def frames(self) -> int:
        """Frames behind the pixel that has most."""
        ...

    @property
    def frames_by_pixel(self) -> int | NDArray[np.int64]:
        """Frames behind every pixel if all have the same, otherwise of shape (row, col)."""
        ...

    def add(self, block: LiveBlock, /) -> None:
        """Add a block.

        Parameters
        ----------
        block : LiveBlock
            The newest block, which is given back once it is not needed.
        """
        ...

    def add_all(self, blocks: Sequence[LiveBlock], /) -> None:
        """Add blocks that have waited while a picture was made.

        Parameters
        ----------
        blocks : sequence of LiveBlock
            The blocks in their order, the newest last.
        """
        ...

    def clear(self) -> None:
        """Begin anew everywhere."""
        ...

    def histogram(self) -> Counts:
        """Return the sum in an array that later blocks do not change."""
        ...
