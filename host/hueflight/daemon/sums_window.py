# SPDX-License-Identifier: Apache-2.0
"""The newest pictures of sums, added up for a live picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.acquisition.snapshot import LiveSums
from hueflight.calibration import Calibration
from hueflight.daemon.block_window import PARTS
from hueflight.devices.reduction import Reduction
from hueflight.errors import HistogramError
from hueflight.reconstruction.sums.design import SumsDesign
from hueflight.reconstruction.sums.method import reconstruct_sums
from hueflight_protocol import SumsPicture
from hueflight_protocol.reduction import MOST_SUM_BITS, ReductionTables


@dataclass(eq=False)
class _Part:
    """Sum of some pictures that follow one another."""

    values: NDArray[np.uint64]
    frames: NDArray[np.int64]
    saturated: NDArray[np.bool_]
    pictures: int = 1


class SumsWindow:
    """Sum of the newest pictures of sums of a run, whose memory does not grow with its length.

    Up to `PARTS` pictures are kept as they are; a longer window is kept as about as many partial
    sums, and then holds up to a tenth more than its length.

    Parameters
    ----------
    length : int
        Pictures in the sum.

    Attributes
    ----------
    length : int
        Pictures in the sum.
    """

    def __init__(self, length: int) -> None:
        self.length = length
        self._of_part = -(-length // PARTS)
        # of a window of parts, the newest one is not complete yet
        self._most_parts = -(-length // self._of_part) + (self._of_part > 1)
        self._parts: deque[_Part] = deque()
        self._newest: LiveSums | None = None
        self._wide: ReductionTables | None = None  # of a sum of several pictures

    @property
    def frames_by_pixel(self) -> NDArray[np.int64]:
        """Frames behind each pixel, shape (row, col)."""
        return np.stack([part.frames for part in self._parts]).sum(axis=0)

    @property
    def empty(self) -> bool:
        """True if nothing is in the sum."""
        return not self._parts

    @property
    def photons(self) -> NDArray[np.int64]:
        """Photons of each pixel, shape (row, col), which the first sum counts."""
        return self._total()[0][..., 0].astype(np.int64)

    def add_all(self, pictures: Sequence[LiveSums]) -> None:
        """Add pictures, and drop the oldest ones if the window is full.

        Parameters
        ----------
        pictures : sequence of LiveSums
            The newest pictures; of those that would drop out at once nothing is unpacked.

        Raises
        ------
        HistogramError
            If a picture has sums of other tables than the camera was given.
        """
        for picture in pictures[-self.length :]:
            before = self._newest
            if before is not None and (before.run, before.reduction) != (
                picture.run, picture.reduction,
            ):  # fmt: skip
                self.clear()
            self._newest = picture
            self._add(picture.block.picture, picture.reduction)

    def _add(self, picture: SumsPicture, reduction: Reduction) -> None:
        first, tables = picture.first, reduction.tables
        if (first.tables, first.widths) != (tables.hash, tables.widths):
            self.clear()
            raise HistogramError(
                f"the camera sends sums of the tables {first.tables:#010x}, not of those that it "
                f"was given ({tables.hash:#010x}): begin the live run anew"
            )
        frames = np.where(picture.present, np.int64(first.frames), 0)
        saturated = (picture.values == tables.limits).any(axis=-1)
        last = self._parts[-1] if self._parts else None
        if last is not None and last.pictures < self._of_part:
            last.values += picture.values
            last.frames += frames
            last.saturated |= saturated
            last.pictures += 1
            return
        values = picture.values.astype(np.uint64)
        self._parts.append(_Part(values, frames, saturated))
        while len(self._parts) > self._most_parts:
            self._parts.popleft()

    def clear(self) -> None:
        """Forget all pictures."""
        self._parts.clear()
        self._newest = self._wide = None

    def reconstruct(self, calibration: Calibration, /) -> xr.Dataset:
        """Reconstruct depth and reflectance from the sum.

        Parameters
        ----------
        calibration : Calibration
            Calibration of the same instrument.

        Returns
        -------
        Dataset
            Image as `hueflight.reconstruct_sums` gives it.

        Raises
        ------
        HueflightError
            If the sums do not fit the calibration.
        """
        assert self._newest is not None
        reduction = self._newest.reduction
        values, tables = self._total()
        return reconstruct_sums(
            values,
            SumsDesign(tables, reduction.middle_ns, reduction.reach_ns),
            calibration,
            offsets=reduction.offsets,
            frames=np.maximum(self.frames_by_pixel, 1),  # pixels without any have no photon either
        )

    def _total(self) -> tuple[NDArray[np.uint64], ReductionTables]:
        """The sum, and the tables with widths that hold it."""
        assert self._newest is not None
        tables = self._newest.reduction.tables
        if len(self._parts) == 1 and self._parts[0].pictures == 1:
            return self._parts[0].values, tables
        if self._wide is None:
            widths = (MOST_SUM_BITS,) * tables.sums
            self._wide = ReductionTables(tables.entries, widths, tables.first, tables.last)
        values = self._parts[0].values.copy()
        saturated = self._parts[0].saturated.copy()
        for part in list(self._parts)[1:]:
            values += part.values
            saturated |= part.saturated
        most = (1 << MOST_SUM_BITS) - 1
        np.minimum(values, most, out=values)
        values[saturated] = most
        return values, self._wide
