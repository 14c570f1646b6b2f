# SPDX-License-Identifier: Apache-2.0
"""Significance of changes in NumPy: the definition of ``_c/scene_change.h``, and fallback."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.ingest import SMOOTHINGS


def significance(
    newest: NDArray[np.float64],
    earlier: NDArray[np.float64],
    ratio: NDArray[np.float64],
    rows: int,
    cols: int,
    groups: int,
    size: int,
    window: int,
    brightness_tolerance: float,
    shift_tolerance: float,
    out: NDArray[np.float64],
    /,
) -> None:
    """Compare counts with what earlier counts predict, by the greatest of several contrasts.

    The contrasts are the counts in each of some time windows, all counts, and a shift in time, of
    all tiles of a cell together.

    Parameters
    ----------
    newest, earlier : numpy.ndarray, float64, shape (tile row, tile col, group)
        Counts.
    ratio : numpy.ndarray, float64, shape (tile row, tile col)
        Exposures of `newest` per exposure of `earlier`; 0 leaves a tile out.
    rows, cols, groups : int
        Shape of the counts; 2 groups or more.
    size : int
        Tiles on a side of a cell. Cells at the right and the lower edge may be smaller.
    window : int
        Groups in a time window.
    brightness_tolerance : float
        Relative change of brightness that is none.
    shift_tolerance : float
        Shift that is none, in groups.
    out : numpy.ndarray, float64, shape (cell row, cell col)
        Receives the standard deviations of the most significant contrast.
    """
    del groups

    def of_cells(tiles: NDArray[np.float64]) -> NDArray[np.float64]:
        down = np.add.reduceat(tiles, np.arange(0, rows, size), axis=0)
        return np.add.reduceat(down, np.arange(0, cols, size), axis=1)

    compared = ratio > 0
    expected = earlier * ratio[..., None]
    tiles = of_cells(compared.astype(np.float64))
    mean_ratio = np.divide(of_cells(ratio), tiles, out=np.zeros(tiles.shape), where=tiles > 0)
    counts = [newest * compared[..., None], expected, expected * ratio[..., None]]
    seen, predicted, spread = (of_cells(part) for part in counts)
    of_counts = count_significance(
        _in_windows(seen, window),
        _in_windows(predicted, window),
        _in_windows(spread, window),
        mean_ratio[..., None],
        tolerance=brightness_tolerance,
    )
    of_shift = _shift_significance(seen, predicted, spread, shift_tolerance)
    np.maximum(of_counts.max(axis=-1), of_shift, out=out)


def count_significance(
    seen: NDArray[np.float64],
    expected: NDArray[np.float64],
    spread: NDArray[np.float64],
    ratio: NDArray[np.float64],
    /,
    *,
    tolerance: float = 0.0,
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
        time ``expected / spread`` times as long.
    ratio : array of float
        Exposures of `seen` per exposure of the earlier counts, where nothing is expected.
    tolerance : float
        Relative change of brightness that is none; added to the deviation of the prediction.

    Returns
    -------
    array of float
        Significance, 0 or above.
    """
    spread = spread + (tolerance * expected) ** 2
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
    return _weights_of_smoothed(_smoothed(earlier))


def _weights_of_smoothed(smooth: NDArray[np.float64]) -> NDArray[np.float64]:
    floor = 1 + 0.05 * smooth.mean(axis=-1, keepdims=True)
    weights = np.gradient(smooth, axis=-1)
    weights /= smooth + floor
    return weights


def _shift_significance(
    seen: NDArray[np.float64],
    expected: NDArray[np.float64],
    spread: NDArray[np.float64],
    tolerance: float,
) -> NDArray[np.float64]:
    """Significance of a shift in time, with the tolerance added to its variance."""
    total, variance = expected.sum(axis=-1), spread.sum(axis=-1)
    # as many photons as there were, so that the floor of the weights means the same at all times
    scale = np.divide(total, variance, out=np.ones_like(total), where=variance > 0)
    smooth = _smoothed(expected * scale[..., None])
    weights = _weights_of_smoothed(smooth)
    shift = _dot(weights, seen) - _dot(weights, expected)
    squares = weights**2
    information = _dot(squares, smooth) / scale
    variance = information + _dot(squares, spread)
    variance += (tolerance * information) ** 2
    return np.abs(shift) / np.sqrt(np.where(variance > 0, variance, np.inf))


def _dot(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums of products along the last axis."""
    return np.einsum("...i,...i->...", first, second)


def _in_windows(counts: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Sums over each window of so many groups, and last over all groups."""
    windows = np.add.reduceat(counts, np.arange(0, counts.shape[-1], size), axis=-1)
    return np.concatenate([windows, counts.sum(axis=-1, keepdims=True)], axis=-1)


def _smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values smoothed along the last axis; the ends count as often as they reach beyond it."""
    # binomial weights are sums of neighbors, taken so many times
    reach = SMOOTHINGS // 2
    length = values.shape[-1]
    sums = values[..., np.arange(-reach, length + reach).clip(0, length - 1)]
    for _ in range(SMOOTHINGS):
        sums = sums[..., 1:] + sums[..., :-1]
    sums *= 0.5**SMOOTHINGS
    return sums


def _n_log(counts: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """``counts · log(counts / mean)``, 0 where there are no counts."""
    quotient = np.divide(counts, mean, out=np.ones(counts.shape), where=(counts > 0) & (mean > 0))
    return counts * np.log(quotient)
