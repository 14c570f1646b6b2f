# SPDX-License-Identifier: Apache-2.0
"""The newest pictures of sums, added up for a live picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.acquisition.snapshot import LiveSums
from hueflight.calibration import Calibration
from hueflight.daemon.block_window import PARTS
from hueflight.devices.reduction import Reduction
from hueflight.errors import HistogramError
from hueflight.ingest.scene_change import of_pixels, of_tiles
from hueflight.ingest.tile_history import TileHistory
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.sums.changes import SumsContrasts, unnoticed_shift_ns
from hueflight.reconstruction.sums.design import SumsDesign
from hueflight.reconstruction.sums.method import reconstruct_sums
from hueflight_protocol import SumsPicture
from hueflight_protocol.reduction import MOST_SUM_BITS, ReductionTables

UNNOTICED = "unnoticed_depth_change"  #: attribute of images in which photons add up
MOST = (1 << MOST_SUM_BITS) - 1  #: of a sum of several pictures, and the value of saturated ones


@dataclass(eq=False)
class _Part:
    """Sum of some pictures that follow one another."""

    values: NDArray[np.uint64]
    frames: NDArray[np.int64]
    saturated: NDArray[np.bool_]
    pictures: int = 1

    def add(self, other: _Part) -> None:
        """Add the sum of later pictures."""
        self.values += other.values
        self.frames += other.frames
        self.saturated |= other.saturated
        self.pictures += other.pictures

    def begin(self, pixels: NDArray[np.bool_]) -> None:
        """Begin anew in some pixels."""
        self.values[pixels] = 0
        self.frames[pixels] = 0
        self.saturated[pixels] = False


class SumsWindow:
    """Sum of the newest pictures of sums of a run, whose memory does not grow with its length.

    Up to `PARTS` pictures are kept as they are; a longer window is kept as about as many partial
    sums, and then holds up to a tenth more than its length.

    Parameters
    ----------
    length : int
        Pictures in the sum.
    frames : int, optional
        Frames that the sum is to hold, at least: where the camera sends sums of another number of
        frames, as many pictures as that takes are in the sum, whatever `length` says.

    Attributes
    ----------
    length : int
        Pictures in the sum.
    """

    def __init__(self, length: int, frames: int | None = None) -> None:
        self._frames = frames
        self._set_length(length)
        self._parts: deque[_Part] = deque()
        self._newest: LiveSums | None = None
        self._wide: ReductionTables | None = None  # of a sum of several pictures

    def _set_length(self, length: int) -> None:
        self.length = length
        self._of_part = -(-length // PARTS)
        # of a window of parts, the newest one is not complete yet
        self._most_parts = -(-length // self._of_part) + (self._of_part > 1)

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
        if pictures and self._frames is not None:
            self._set_length(-(-self._frames // pictures[-1].reduction.frames))
        for picture in pictures[-self.length :]:
            before = self._newest
            if before is not None and (before.run, before.reduction) != (
                picture.run, picture.reduction,
            ):  # fmt: skip
                self.clear()
            self._newest = picture
            found = picture.block.picture
            self._checked(found, picture.reduction)
            self._add(found, picture.reduction)

    def _checked(self, picture: SumsPicture, reduction: Reduction) -> None:
        first, tables = picture.first, reduction.tables
        if (first.tables, first.widths) != (tables.hash, tables.widths):
            self.clear()
            raise HistogramError(
                f"the camera sends sums of the tables {first.tables:#010x}, not of those that it "
                f"was given ({tables.hash:#010x}): begin the live run anew"
            )

    def _add(self, picture: SumsPicture, reduction: Reduction) -> None:
        saturated = (picture.values == reduction.tables.limits).any(axis=-1)
        last = self._parts[-1] if self._parts else None
        newest = _Part(picture.values.astype(np.uint64), picture.frames.copy(), saturated)
        if last is not None and last.pictures < self._of_part:
            last.add(newest)
            return
        self._parts.append(newest)
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
        values = self._parts[0].values.copy()
        saturated = self._parts[0].saturated.copy()
        for part in list(self._parts)[1:]:
            values += part.values
            saturated |= part.saturated
        np.minimum(values, MOST, out=values)
        values[saturated] = MOST
        return values, self._widened(tables)

    def _widened(self, tables: ReductionTables) -> ReductionTables:
        """The tables with widths that hold a sum of several pictures."""
        if self._wide is None:
            self._wide = replace(tables, widths=(MOST_SUM_BITS,) * tables.sums)
        return self._wide


class GatheredSums(SumsWindow):
    """Sum of pictures of sums in which photons add up where nothing changes.

    See `hueflight.ingest.tile_history.TileHistory`, and `hueflight.reconstruction.sums.changes` for
    how changes are told from sums.

    Parameters
    ----------
    limit_frames : int, optional
        Most frames in the sum. It then holds from half as many up to all of them. By default there
        is no limit but that of the sums, `MOST`, at which a tile begins anew.
    """

    def __init__(self, limit_frames: int | None = None) -> None:
        super().__init__(1)
        self._limit = limit_frames
        self._young: _Part | None = None  # the latest half, where there is a limit
        self._young_tiles: NDArray[np.float64] = np.zeros((0, 0))
        self._young_frames = 0
        self._history: TileHistory | None = None

    def add_all(self, pictures: Sequence[LiveSums]) -> None:
        """Add pictures; see `SumsWindow.add_all`.

        Parameters
        ----------
        pictures : sequence of LiveSums
            The newest pictures.
        """
        for picture in pictures:
            super().add_all([picture])

    def clear(self) -> None:
        """Forget all pictures."""
        super().clear()
        self._young = self._history = None

    def _add(self, picture: SumsPicture, reduction: Reduction) -> None:
        tables, frames = reduction.tables, int(picture.frames.max())
        newest = _Part(
            picture.values.astype(np.uint64),
            picture.frames.copy(),
            (picture.values == tables.limits).any(axis=-1),
        )
        # tiles of which a part is missing are added, but not compared
        tiles = of_tiles(picture.values)
        whole = of_tiles(~picture.present) == 0
        tiles *= whole[..., None]
        mean_frames = of_tiles(picture.frames) / of_tiles(np.ones_like(picture.frames))
        tile_frames = np.where(whole, mean_frames, 0.0)
        if self._history is None:
            rows, cols, sums = tiles.shape
            self._history = TileHistory((rows, cols, sums), SumsContrasts.of(tables).compare)
            self._parts.append(_empty(newest))
            self._begin_half(newest, tile_frames)
        elif self._limit is not None and 2 * (self._young_frames + frames) > self._limit:
            self._history.keep(self._young_tiles)
            assert self._young is not None
            self._parts[0] = self._young
            self._begin_half(newest, tile_frames)
        (total,) = self._parts
        full = of_tiles((total.values + newest.values).max(axis=-1) >= MOST) > 0
        changed = self._history.add(tiles, tile_frames, lambda _: full)
        anew = of_pixels(changed, *picture.present.shape)
        total.begin(anew)
        total.add(newest)
        if self._young is not None:
            self._young.begin(anew)
            self._young.add(newest)
            self._young_tiles = np.where(changed, 0.0, self._young_tiles) + tile_frames
            self._young_frames += frames

    def reconstruct(self, calibration: Calibration, /) -> xr.Dataset:
        """Reconstruct depth and reflectance from the sum; see `SumsWindow.reconstruct`.

        Parameters
        ----------
        calibration : Calibration
            Calibration of the same instrument.

        Returns
        -------
        Dataset
            The image. Its attribute `UNNOTICED` states by how much, in metres, a surface may have
            moved without its tile beginning anew.
        """
        image = super().reconstruct(calibration)
        assert self._newest is not None
        reduction = self._newest.reduction
        shift_ns = unnoticed_shift_ns(
            calibration, reduction.tables, reduction.middle_ns, reduction.reach_ns
        )
        image.attrs[UNNOTICED] = shift_ns * SPEED_OF_LIGHT_M_PER_NS / 2
        return image

    def _begin_half(self, like: _Part, tile_frames: NDArray[np.float64]) -> None:
        if self._limit is not None:
            self._young, self._young_frames = _empty(like), 0
            self._young_tiles = np.zeros_like(tile_frames)

    def _total(self) -> tuple[NDArray[np.uint64], ReductionTables]:
        assert self._newest is not None
        (total,) = self._parts
        values = np.where(total.saturated[..., None], np.uint64(MOST), total.values)
        return values, self._widened(self._newest.reduction.tables)


def _empty(like: _Part) -> _Part:
    """A sum of nothing, as large as another."""
    return _Part(
        np.zeros_like(like.values),
        np.zeros_like(like.frames),
        np.zeros_like(like.saturated),
        pictures=0,
    )
