# SPDX-License-Identifier: Apache-2.0
"""Tell where a scene has changed: the newest counts against all those gathered before them.

The image is divided into tiles of 4 × 4 pixels, and the codes into groups. Of every tile, of every
square of 4 × 4 tiles, and of every 4 × 4 of these, some contrasts between the newest and the
earlier counts are compared with what chance explains: all photons, the photons in each of several
time windows, and a shift in time. Neighboring pixels are tested together because a single pixel
receives too few photons within one picture for a change to be told from chance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.ingest import SCENE_TILE as TILE
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.kernels import choose

Compare = Callable[
    [NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int], NDArray[np.float64]
]
Value = TypeVar("Value", bound=np.generic)  # of a tile
SIZES = (1, 4, 16)  #: tiles on a side of what is compared: tiles, squares, larger squares
GROUPS = 128  #: of codes, at most
WINDOWS = 16  #: of groups, at most
#: by which a contrast must differ. One in 5e8 does so by chance; with 192 × 128 pixels, this is one
#: tile in about 17 000 pictures
SIGMA = 6.0
BRIGHTNESS_TOLERANCE = 0.02  #: relative; LEDs drift by about as much while they warm up
SHIFT_TOLERANCE = 0.01  #: in groups of codes


def tile_counts(histogram: Counts, /, *, reports_empty: bool = True) -> NDArray[np.float64]:
    """Return the counts of each tile in groups of codes.

    Parameters
    ----------
    histogram : array of unsigned int, shape (row, col, code)
        Counts, below 2³².
    reports_empty : bool
        True if code 0 means that there was no photon; it is then left out.

    Returns
    -------
    array of float64, shape (tile row, tile col, group)
        Counts. The tiles at the right and the lower edge may be smaller than others.
    """
    rows, cols, codes = histogram.shape
    size = -(-codes // GROUPS)
    out = np.empty((-(-rows // TILE), -(-cols // TILE), -(-codes // size)))
    counts = np.ascontiguousarray(histogram)
    if counts.dtype not in (np.uint16, np.uint32):
        counts = counts.astype(np.uint32)
    wide = counts.dtype == np.uint32
    choose().group_counts(counts, wide, rows, cols, codes, size, reports_empty, out)
    return out


def of_tiles(pixels: NDArray[np.generic], /) -> NDArray[np.float64]:
    """Return the sum over the pixels of each tile.

    Parameters
    ----------
    pixels : array, shape (row, col, ...)
        Values of pixels.

    Returns
    -------
    array of float64, shape (tile row, tile col, ...)
        Sums. The tiles at the right and the lower edge may be smaller than others.
    """
    rows, cols = pixels.shape[:2]
    down = np.add.reduceat(pixels, np.arange(0, rows, TILE), axis=0, dtype=np.float64)
    return np.add.reduceat(down, np.arange(0, cols, TILE), axis=1)


def of_pixels(tiles: NDArray[Value], rows: int, cols: int, /) -> NDArray[Value]:
    """Return the values of tiles for each of their pixels.

    Parameters
    ----------
    tiles : array, shape (tile row, tile col)
        Values of tiles.
    rows, cols : int
        Pixels of the image.

    Returns
    -------
    array, shape (row, col)
        Value of each pixel's tile.
    """
    return np.repeat(np.repeat(tiles, TILE, 0), TILE, 1)[:rows, :cols]


def changed_tiles(
    newest: NDArray[np.float64],
    newest_frames: NDArray[np.float64],
    earlier: NDArray[np.float64],
    earlier_frames: NDArray[np.float64],
    /,
    *,
    sigma: float = SIGMA,
    compare: Compare | None = None,
) -> NDArray[np.bool_]:
    """Return which tiles have changed.

    Parameters
    ----------
    newest : array of float, shape (tile row, tile col, group)
        Counts of the newest frames.
    newest_frames : array of float, shape (tile row, tile col)
        Frames behind them.
    earlier : array of float, shape (tile row, tile col, group)
        Counts of other frames, before those.
    earlier_frames : array of float, shape (tile row, tile col)
        Frames behind them. Tiles without frames on either side are not compared.
    sigma : float
        Standard deviations by which a contrast must differ.
    compare : callable, optional
        Takes `newest`, `earlier`, their ratio of frames (0 leaves a tile out) and a number, and
        returns the significance of changes in squares of so many tiles on a side; by default
        `compare_counts`.

    Returns
    -------
    array of bool, shape (tile row, tile col)
        True in tiles that have changed, and in all tiles of a square that has changed. A square is
        judged without those of its tiles that have changed by themselves, and without their
        neighbors.
    """
    known = (newest_frames > 0) & (earlier_frames > 0)
    ratio = np.divide(newest_frames, earlier_frames, out=np.zeros(known.shape), where=known)
    rows, cols = known.shape
    changed = np.zeros(known.shape, bool)
    for size in SIZES:
        found = (compare or compare_counts)(newest, earlier, ratio, size) > sigma
        if not found.any():
            continue
        changed |= np.repeat(np.repeat(found, size, 0), size, 1)[:rows, :cols] & known
        # a tile that has changed by itself would make its square seem to have changed as well
        ratio = np.where(grown(changed), 0.0, ratio)
    return changed


def compare_counts(
    newest: NDArray[np.float64],
    earlier: NDArray[np.float64],
    ratio: NDArray[np.float64],
    size: int,
    /,
) -> NDArray[np.float64]:
    """Return the significance of changes of counts.

    Parameters
    ----------
    newest, earlier : array of float, shape (tile row, tile col, group)
        Counts.
    ratio : array of float, shape (tile row, tile col)
        Frames of `newest` per frame of `earlier`; 0 leaves a tile out.
    size : int
        Tiles on a side of each square that is compared.

    Returns
    -------
    array of float, shape (square row, square col)
        Standard deviations of the contrast that differs most.
    """
    rows, cols, groups = newest.shape
    out = np.empty((-(-rows // size), -(-cols // size)))
    choose().significance(
        *(newest, earlier, ratio, rows, cols, groups, size, -(-groups // WINDOWS)),
        *(BRIGHTNESS_TOLERANCE, SHIFT_TOLERANCE, out),
    )
    return out


def grown(mask: NDArray[np.bool_], /) -> NDArray[np.bool_]:
    """Return a mask of tiles with the eight neighbors of each one.

    Parameters
    ----------
    mask : array of bool, shape (tile row, tile col)
        Tiles.

    Returns
    -------
    array of bool, shape (tile row, tile col)
        The tiles and their neighbors.
    """
    out = mask.copy()
    out[1:] |= mask[:-1]
    out[:-1] |= mask[1:]
    across = out.copy()
    out[:, 1:] |= across[:, :-1]
    out[:, :-1] |= across[:, 1:]
    return out
