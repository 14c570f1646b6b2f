# SPDX-License-Identifier: Apache-2.0
"""Tell where a scene has changed: the newest counts against all those gathered before them.

The image is divided into tiles of 4 × 4 pixels, and the codes into groups. Of every tile, of every
square of 4 × 4 tiles, and of every 4 × 4 of these, some contrasts between the newest and the
earlier counts are compared with what chance explains: all photons, the photons in each of several
time windows, and a shift in time. Neighboring pixels are tested together because a single pixel
receives too few photons within one picture for a change to be told from chance.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from hueflight.ingest.accumulator import Counts

TILE = 4  #: pixels on a side of a tile
SQUARE = 4  #: tiles on a side of a square, and squares on a side of the next larger one
LEVELS = 3  #: tiles, squares, larger squares
GROUPS = 128  #: of codes, at most
WINDOWS = 16  #: of groups, at most
#: by which a contrast must differ. One in 5e8 does so by chance; with 192 × 128 pixels, this is one
#: tile in about 17 000 pictures
SIGMA = 6.0
BRIGHTNESS_TOLERANCE = 0.02  #: relative; LEDs drift by about as much while they warm up
SHIFT_TOLERANCE = 0.01  #: in groups of codes
_SMOOTH = np.array([1, 4, 6, 4, 1]) / 16


def tile_counts(
    histogram: Counts, frames: int, /, *, reports_empty: bool = True
) -> NDArray[np.float64]:
    """Return the counts of each tile in groups of codes.

    Parameters
    ----------
    histogram : array of unsigned int, shape (row, col, code)
        Counts of some frames, at most one for each frame and code.
    frames : int
        Frames behind the histogram.
    reports_empty : bool
        True if code 0 means that there was no photon; it is then left out.

    Returns
    -------
    array of float64, shape (tile row, tile col, group)
        Counts. The tiles at the right and the lower edge may be smaller than others.
    """
    small = frames * TILE * TILE <= np.iinfo(histogram.dtype).max
    dtype = histogram.dtype if small else np.dtype(np.uint64)
    size = -(-histogram.shape[2] // GROUPS)
    missing = [-n % whole for n, whole in zip(histogram.shape, (TILE, TILE, size), strict=True)]
    if any(missing):
        histogram = np.pad(histogram, [(0, n) for n in missing])
    rows, cols, codes = histogram.shape
    bands = histogram.reshape(rows // TILE, TILE, cols * codes).sum(axis=1, dtype=dtype)
    tiles = bands.reshape(len(bands), cols // TILE, TILE, codes).sum(axis=2, dtype=dtype)
    if reports_empty:
        tiles[..., 0] = 0
    return reduce(np.add, (tiles[..., first::size].astype(np.float64) for first in range(size)))


def changed_tiles(
    newest: NDArray[np.float64],
    newest_frames: NDArray[np.float64],
    earlier: NDArray[np.float64],
    earlier_frames: NDArray[np.float64],
    /,
    *,
    sigma: float = SIGMA,
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
    for level in range(LEVELS):
        # a tile that has changed by itself would make its square seem to have changed as well
        left = known & ~grown(changed)
        seen = np.where(left[..., None], newest, 0)
        expected = np.where(left[..., None], earlier * ratio[..., None], 0)
        sums = [seen, expected, expected * ratio[..., None], np.where(left, ratio, 0), left * 1.0]
        for _ in range(level):
            sums = [_of_squares(part) for part in sums]
        *counts, ratios, tiles = sums
        mean_ratio = np.divide(ratios, tiles, out=np.zeros(tiles.shape), where=tiles > 0)
        found = _significance(*counts, mean_ratio) > sigma
        size = SQUARE**level
        changed |= np.repeat(np.repeat(found, size, 0), size, 1)[:rows, :cols] & known
    return changed


def count_significance(
    seen: NDArray[np.float64],
    expected: NDArray[np.float64],
    spread: NDArray[np.float64],
    ratio: NDArray[np.float64],
    /,
) -> NDArray[np.float64]:
    """Return by how many standard deviations counts differ from what earlier counts predict.

    This is the root of the deviance of two Poisson counts with a known ratio of exposures, which
    stays accurate where the counts are small.

    Parameters
    ----------
    seen : array of float
        Counts.
    expected : array of float
        Counts that are predicted.
    spread : array of float
        Variance of the prediction, for which it counts as ``expected**2 / spread`` photons in a
        time ``expected / spread`` times as long. The tolerance of brightness is added to it.
    ratio : array of float
        Exposures of `seen` per exposure of the earlier counts, where nothing is expected.

    Returns
    -------
    array of float
        Significance, 0 or above.
    """
    spread = spread + (BRIGHTNESS_TOLERANCE * expected) ** 2
    some = expected > 0
    times = np.divide(
        spread, expected, out=np.broadcast_to(ratio, expected.shape).copy(), where=some
    )
    counted = np.divide(expected, times, out=np.zeros(expected.shape), where=some)
    share = times / (1 + times)
    total = seen + counted
    deviance = _n_log(seen, total * share) + _n_log(counted, total * (1 - share))
    return np.sqrt(np.maximum(2 * deviance, 0))


def shift_weights(earlier: NDArray[np.float64], /) -> NDArray[np.float64]:
    """Return how strongly each group's counts change with a shift in time.

    Parameters
    ----------
    earlier : array of float, shape (..., group)
        Counts.

    Returns
    -------
    array of float, shape (..., group)
        Derivative of the smoothed counts, relative to themselves, by a shift in groups.
    """
    smooth = _smoothed(earlier)
    floor = 1 + 0.05 * smooth.mean(axis=-1, keepdims=True)
    return np.gradient(smooth, axis=-1) / (smooth + floor)


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


def _significance(
    seen: NDArray[np.float64],
    expected: NDArray[np.float64],
    spread: NDArray[np.float64],
    ratio: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Greatest significance of all contrasts, shape (row, col) of arrays (row, col, group)."""
    of_counts = count_significance(
        _in_windows(seen), _in_windows(expected), _in_windows(spread), ratio[..., None]
    )
    return np.maximum(
        of_counts.max(axis=-1),
        _shift_significance(seen, expected, spread),
    )


def _shift_significance(
    seen: NDArray[np.float64],
    expected: NDArray[np.float64],
    spread: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Significance of a shift in time, with the tolerance added to its variance."""
    total = expected.sum(axis=-1, keepdims=True)
    variance = spread.sum(axis=-1, keepdims=True)
    # as many photons as there were, so that the floor of the weights means the same at all times
    weights = shift_weights(
        np.divide(expected * total, variance, out=np.zeros(expected.shape), where=variance > 0)
    )
    shift = (weights * (seen - expected)).sum(axis=-1)
    information = (weights**2 * _smoothed(expected)).sum(axis=-1)
    variance = information + (weights**2 * spread).sum(axis=-1)
    variance += (SHIFT_TOLERANCE * information) ** 2
    return np.abs(shift) / np.sqrt(np.where(variance > 0, variance, np.inf))


def _in_windows(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over each window of groups, and last over all groups."""
    size = -(-counts.shape[-1] // WINDOWS)
    missing = -counts.shape[-1] % size
    if missing:
        counts = np.pad(counts, [(0, 0)] * (counts.ndim - 1) + [(0, missing)])
    windows = sum(counts[..., first::size] for first in range(size))
    return np.concatenate([windows, counts.sum(axis=-1, keepdims=True)], axis=-1)


def _of_squares(part: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over squares of tiles."""
    rows, cols = part.shape[:2]
    down = np.add.reduceat(part, np.arange(0, rows, SQUARE), axis=0)
    return np.add.reduceat(down, np.arange(0, cols, SQUARE), axis=1)


def _smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values smoothed along the last axis; the ends count as often as they reach beyond it."""
    reach = len(_SMOOTH) // 2
    ends = [(0, 0)] * (values.ndim - 1) + [(reach, reach)]
    padded = np.pad(values, ends, mode="edge")
    length = values.shape[-1]
    shifted = (part * padded[..., at : at + length] for at, part in enumerate(_SMOOTH))
    return reduce(np.add, shifted)


def _n_log(counts: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """``counts · log(counts / mean)``, 0 where there are no counts."""
    quotient = np.divide(counts, mean, out=np.ones(counts.shape), where=(counts > 0) & (mean > 0))
    return counts * np.log(quotient)
