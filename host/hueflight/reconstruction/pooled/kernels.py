# SPDX-License-Identifier: Apache-2.0
"""Loops over photons and over neighbors, compiled where possible: the same result either way.

Few photons are handled one by one, not as a histogram: a list of arrival times per pixel. Neighbors
contribute with a weight between 0 and 1, which falls with distance, and to 0 where the pixel's own
pool so far shows something else than the neighbor (propagation and separation: Polzehl and
Spokoiny, J. R. Stat. Soc. B 62, 335, 2000). `hueflight.backend` decides whether the compiled loops
run.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hueflight import backend
from hueflight.backend.pooled import (
    GRID,
    LAGS,
    LANES,
    LIST,
    MOST_GROUPS,
    MOST_PLANES,
    PERIOD,
    POOL,
    POOL_LIMITS,
    POOL_SIZES,
    SCORES,
    SQUARES,
    SQUARES_SIZE,
    WINDOWS,
)

ENTRIES = 12  #: a pixel that photons are at first given room for

Floats = NDArray[np.float32]
Result = TypeVar("Result")


def in_parts(
    work: Callable[[tuple[int, int]], Result], items: int, parts: int, threads: int
) -> list[Result]:
    """Return the results of work on successive ranges of items, in order.

    Parameters
    ----------
    work : callable
        Function of a range: the first item, and one past the last.
    items : int
        Number of items.
    parts : int
        Number of ranges, at most.
    threads : int
        Threads that share the ranges.

    Returns
    -------
    list
        A result for each range.
    """
    edges = np.linspace(0, items, max(1, min(parts, items)) + 1).round().astype(int).tolist()
    stretches = list(itertools.pairwise(edges))
    if threads == 1 or len(stretches) == 1:
        return [work(stretch) for stretch in stretches]
    return list(_workers(threads).map(work, stretches))


@cache
def _workers(threads: int) -> ThreadPoolExecutor:
    """Threads that wait for work: starting them anew for each loop costs as much as some loops."""
    return ThreadPoolExecutor(threads, thread_name_prefix="pooling")


if hasattr(os, "register_at_fork"):  # a forked process has the pool but not its threads
    os.register_at_fork(after_in_child=_workers.cache_clear)


@dataclass(frozen=True)
class Photons:
    """Arrival times of photons, one pixel after another.

    Attributes
    ----------
    starts : ndarray of int64, shape (pixel + 1,)
        First entry of each pixel.
    times_ns : ndarray of float32, shape (entry,)
        Time within the period, minus the delay of the pixel itself.
    weights : ndarray of float32, shape (entry,)
        Photons that share the time.
    """

    starts: NDArray[np.int64]
    times_ns: Floats
    weights: Floats

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.starts.size - 1

    @property
    def owners(self) -> NDArray[np.intp]:
        """(entry,) pixel of each entry."""
        return np.repeat(np.arange(self.pixels), np.diff(self.starts))

    def buffers(self) -> dict[str, NDArray[Any]]:
        """Return the arrays as the compiled loops name them."""
        return {"starts": self.starts, "times": self.times_ns, "weights": self.weights}

    def part(self, stretch: tuple[int, int]) -> Photons:
        """Return the photons of a range of pixels.

        Parameters
        ----------
        stretch : tuple of int
            First pixel, and one past the last.

        Returns
        -------
        Photons
            Their photons.
        """
        starts = self.starts[stretch[0] : stretch[1] + 1]
        entries = slice(starts[0], starts[-1])
        return Photons(starts - starts[0], self.times_ns[entries], self.weights[entries])

    @classmethod
    def joined(cls, parts: Sequence[Photons]) -> Photons:
        """Join the photons of successive ranges.

        Parameters
        ----------
        parts : sequence of Photons
            Photons of each range.

        Returns
        -------
        Photons
            Photons of all pixels.
        """
        before = np.cumsum([0] + [part.times_ns.size for part in parts[:-1]])
        starts = [part.starts[1:] + first for part, first in zip(parts, before, strict=True)]
        return cls(
            np.concatenate([np.zeros(1, np.int64), *starts]),
            np.concatenate([part.times_ns for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )

    def sums(self, values: NDArray[np.floating]) -> Floats:
        """Sum values of entries over each pixel.

        Parameters
        ----------
        values : ndarray of float, shape (entry,)
            A value for each entry.

        Returns
        -------
        ndarray of float32, shape (pixel,)
            Sums.
        """
        return np.bincount(self.owners, values, self.pixels).astype(np.float32)


def list_photons(
    counts: NDArray[Any], times_ns: Floats, offsets_ns: Floats, period_ns: float
) -> Photons:
    """List the photons of histograms.

    Parameters
    ----------
    counts : ndarray, shape (pixel, code)
        Counts, raw codes on the last axis.
    times_ns : ndarray of float32, shape (code,)
        Arrival that a code stands for, below 0 for codes that are no photon.
    offsets_ns : ndarray of float32, shape (pixel,)
        Delay of the pixel itself.
    period_ns : float
        Time after which pulses repeat.

    Returns
    -------
    Photons
        Arrival times.
    """
    period = np.array([period_ns], np.float32)
    native = backend.compiled("pooled")
    if native is None:
        pixel, code = np.nonzero(np.where(times_ns >= 0, counts, 0))
        starts = np.zeros(len(counts) + 1, np.int64)
        np.cumsum(np.bincount(pixel, minlength=len(counts)), out=starts[1:])
        time = times_ns[code] - offsets_ns[pixel]
        time -= np.floor(time / period) * period
        return Photons(
            starts, np.where(time < period, time, 0), counts[pixel, code].astype(np.float32)
        )
    if counts.dtype not in (np.uint16, np.uint32, np.float32):
        counts = counts.astype(np.float32)
    counts = np.ascontiguousarray(counts)
    starts = np.zeros(len(counts) + 1, np.int64)
    room = ENTRIES * len(counts) + times_ns.size
    while True:
        time, weight = np.empty((2, room), np.float32)
        native.list(
            *LIST.arguments(
                counts=counts,
                code_times=times_ns,
                pixel_delays=offsets_ns,
                period=PERIOD.pack(period_ns=period_ns),
                starts=starts,
                times=time,
                weights=weight,
            )
        )
        if starts[-1] + times_ns.size <= room:
            return Photons(starts, time[: starts[-1]], weight[: starts[-1]])
        room = int(starts[-1]) + times_ns.size


def lag_likelihood(
    photons: Photons, table: Floats, cells_per_ns: float, lags: NDArray[np.int32]
) -> Floats:
    """Compute the log-likelihood of delays.

    Parameters
    ----------
    photons : Photons
        Photons of all pixels.
    table : ndarray of float32, shape (cell,)
        Log-likelihood of a photon in each cell of the period.
    cells_per_ns : float
        Cells of the table per ns.
    lags : ndarray of int32, shape (lag,)
        Delays in whole cells.

    Returns
    -------
    ndarray of float32, shape (pixel, lag)
        Log-likelihood.
    """
    result = np.zeros((photons.pixels, lags.size), np.float32)
    native = backend.compiled("pooled")
    if native is not None:
        grid = GRID.pack(cells_per_ns=cells_per_ns)
        native.lags(
            *LAGS.arguments(**photons.buffers(), table=table, grid=grid, lags=lags, result=result)
        )
        return result
    cell = _cells(photons, np.float32(0), cells_per_ns, table.size)
    for index, lag in enumerate(lags):
        result[:, index] = photons.sums(photons.weights * table[(cell - lag) % table.size])
    return result


def window_counts(
    photons: Photons, delays_ns: Floats, windows: NDArray[np.int8], cells_per_ns: float, count: int
) -> Floats:
    """Count photons by the window that their time after a delay falls into.

    Parameters
    ----------
    photons : Photons
        Photons of all pixels.
    delays_ns : ndarray of float32, shape (pixel,)
        Delay of each pixel.
    windows : ndarray of int8, shape (cell,)
        Window that each cell belongs to.
    cells_per_ns : float
        Cells per ns.
    count : int
        Number of windows.

    Returns
    -------
    ndarray of float32, shape (window, pixel)
        Photons.
    """
    result = np.zeros((count, photons.pixels), np.float32)
    native = backend.compiled("pooled")
    if native is not None:
        native.windows(
            *WINDOWS.arguments(
                **photons.buffers(),
                delays=delays_ns,
                owners=windows,
                grid=GRID.pack(cells_per_ns=cells_per_ns),
                result=result,
            )
        )
        return result
    cell = _cells(photons, delays_ns[photons.owners], cells_per_ns, windows.size)
    np.add.at(result, (windows[cell], photons.owners), photons.weights)
    return result


def square_counts(
    photons: Photons,
    shape: tuple[int, int],
    pixels: NDArray[np.int64],
    reach: NDArray[np.int32],
    delays_ns: Floats,
    windows: NDArray[np.int8],
    cells_per_ns: float,
    count: int,
) -> Floats:
    """Count the photons of squares of pixels by window, all after the delay of the middle.

    Parameters
    ----------
    photons : Photons
        Photons of all pixels.
    shape : tuple of int
        Rows and columns of the image.
    pixels : ndarray of int64, shape (square,)
        Pixel in the middle of each square.
    reach : ndarray of int32, shape (square,)
        Pixels to either side of the middle; the image's border cuts squares off.
    delays_ns : ndarray of float32, shape (square,)
        Delay of the middle.
    windows : ndarray of int8, shape (cell,)
        Window that each cell belongs to.
    cells_per_ns : float
        Cells per ns.
    count : int
        Number of windows.

    Returns
    -------
    ndarray of float32, shape (square, window)
        Photons.
    """
    result = np.zeros((pixels.size, count), np.float32)
    native = backend.compiled("pooled")
    if native is not None:
        native.squares(
            *SQUARES.arguments(
                **photons.buffers(),
                size=SQUARES_SIZE.pack(rows=shape[0], cols=shape[1]),
                pixels=np.ascontiguousarray(pixels, np.int64),
                reach=np.ascontiguousarray(reach, np.int32),
                delays=np.ascontiguousarray(delays_ns, np.float32),
                owners=windows,
                grid=GRID.pack(cells_per_ns=cells_per_ns),
                result=result,
            )
        )
        return result
    numbers = np.arange(photons.pixels).reshape(shape)
    for square, (pixel, far) in enumerate(zip(pixels, reach, strict=True)):
        row, col = divmod(int(pixel), shape[1])
        inside = numbers[max(row - far, 0) : row + far + 1, max(col - far, 0) : col + far + 1]
        entries = np.concatenate(
            [
                np.arange(int(photons.starts[line[0]]), int(photons.starts[line[-1] + 1]))
                for line in inside
            ]
        )
        part = Photons(photons.starts[:0], photons.times_ns[entries], photons.weights[entries])
        cell = _cells(part, delays_ns[square], cells_per_ns, windows.size)
        result[square] = np.bincount(windows[cell], part.weights, count)
    return result


def scores(
    photons: Photons,
    delays_ns: Floats,
    shares: Floats,
    slopes: Floats,
    cells_per_ns: float,
    amplitudes: Floats,
    floors: Floats,
) -> tuple[Floats, Floats]:
    """Compute the derivative of the log-likelihood by the delay, and the information on it.

    Parameters
    ----------
    photons : Photons
        Photons of all pixels.
    delays_ns : ndarray of float32, shape (pixel,)
        Delay of each pixel.
    shares, slopes : ndarray of float32, shape (cell, band)
        Waveforms per ns, and their derivative by time.
    cells_per_ns : float
        Cells per ns.
    amplitudes : ndarray of float32, shape (pixel, band)
        Photons of each band.
    floors : ndarray of float32, shape (pixel,)
        Background per ns.

    Returns
    -------
    score : ndarray of float32, shape (pixel,)
        Derivative of the log-likelihood, per ns.
    information : ndarray of float32, shape (pixel,)
        Fisher information, per ns².
    """
    native = backend.compiled("pooled")
    if native is not None:
        score, information = np.empty((2, photons.pixels), np.float32)
        native.scores(
            *SCORES.arguments(
                **photons.buffers(),
                delays=delays_ns,
                shares=shares,
                slopes=slopes,
                amplitudes=np.ascontiguousarray(amplitudes),
                floors=floors,
                grid=GRID.pack(cells_per_ns=cells_per_ns),
                score=score,
                information=information,
            )
        )
        return score, information
    owners = photons.owners
    cell = _cells(photons, delays_ns[owners], cells_per_ns, len(shares))
    seen = amplitudes[owners]
    rate = floors[owners] + (seen * shares[cell]).sum(axis=-1)
    slope = -(seen * slopes[cell]).sum(axis=-1) / rate
    return photons.sums(photons.weights * slope), photons.sums(photons.weights * slope**2)


def _cells(
    photons: Photons, delays_ns: Floats | np.float32, cells_per_ns: float, cells: int
) -> NDArray[np.intp]:
    place = (photons.times_ns - delays_ns) * np.float32(cells_per_ns)
    return np.floor(place).astype(np.intp) % cells


# -- neighbors -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pooled:
    """Sums over neighbors.

    Attributes
    ----------
    sums : ndarray of float32, shape (plane, row, col)
        Data of the neighbors, each times its weight.
    weight, squares : ndarray of float32, shape (row, col)
        Sums of the weights and of their squares.
    depth_squares : ndarray of float32, shape (row, col)
        Sum of the squares of the weights for the depth.
    """

    sums: Floats
    weight: Floats
    squares: Floats
    depth_squares: Floats


@dataclass(frozen=True)
class Likeness:
    """What is known of each pixel so far, by which neighbors are compared.

    Attributes
    ----------
    means : ndarray of float32, shape (group, row, col)
        Photons per pixel in groups of bands.
    delays_ns : ndarray of float32, shape (row, col)
        Delay.
    pixels : ndarray of float32, shape (row, col)
        Number of pixels in the pool so far.
    information : ndarray of float32, shape (row, col)
        Fisher information of the pool on the delay, per ns².
    """

    means: Floats
    delays_ns: Floats
    pixels: Floats
    information: Floats


@dataclass(frozen=True)
class Limits:
    """Log-likelihood ratios at which a neighbor counts no longer.

    Attributes
    ----------
    color : float
        Of the spectrum, for the weights of spectra.
    depth_color : float
        Of the spectrum, for the weights of depth.
    depth : float
        Of the depth, for both.
    """

    color: float
    depth_color: float
    depth: float


def neighbors(radius: float) -> tuple[NDArray[np.int32], Floats]:
    """Return the neighbors within a radius.

    Parameters
    ----------
    radius : float
        Radius in pixels.

    Returns
    -------
    steps : ndarray of int32, shape (neighbor, 2)
        Rows and columns from the pixel.
    kernel : ndarray of float32, shape (neighbor,)
        Weight 1 − (distance / radius)².
    """
    reach = int(np.ceil(radius))
    steps = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    kernel = 1 - (steps**2).sum(axis=-1) / radius**2
    near = kernel > 0
    return np.ascontiguousarray(steps[near], np.int32), kernel[near].astype(np.float32)


def pool(
    data: Floats,
    spectral: int,
    valid: NDArray[np.bool_],
    active: NDArray[np.bool_],
    like: Likeness,
    radius: float,
    limits: Limits,
    *,
    threads: int = 1,
) -> Pooled:
    """Sum data over the neighbors that look alike.

    Parameters
    ----------
    data : ndarray of float32, shape (plane, row, col)
        Data to sum.
    spectral : int
        Number of planes, the first ones, that are summed with the weights for spectra; the others
        are summed with those for depth.
    valid : ndarray of bool, shape (row, col)
        Pixels that may contribute.
    active : ndarray of bool, shape (row, col)
        Pixels that are asked for; others may be left at 0.
    like : Likeness
        What is known so far.
    radius : float
        Radius in pixels.
    limits : Limits
        Where neighbors count no longer.
    threads : int
        Threads that share the rows.

    Returns
    -------
    Pooled
        Sums over neighbors.
    """
    planes, rows, cols = data.shape
    steps, kernel = neighbors(radius)
    rim = int(np.abs(steps).max(initial=0))
    roots = np.sqrt(like.means)
    native = backend.compiled("pooled")
    if planes > MOST_PLANES or like.means.shape[0] > MOST_GROUPS:
        native = None

    def padded(values: NDArray[Any]) -> Floats:
        edges = [(0, 0)] * (values.ndim - 2) + [(rim, rim), (rim, rim + LANES)]
        return np.pad(np.asarray(values, np.float32), edges)

    spread = [padded(values) for values in (roots, like.delays_ns, valid, data)]
    # of counts n·μ and n·ν the log-likelihood ratio is about 2n·(√μ − √ν)²
    trust = np.ascontiguousarray(2 * like.pixels, np.float32)
    information = np.ascontiguousarray(like.information / 2, np.float32)
    result = np.zeros((planes + 3, rows, cols), np.float32)
    inverse = np.array([1 / limits.color, 1 / limits.depth_color, 1 / limits.depth], np.float32)

    def some_rows(part: tuple[int, int]) -> None:
        if native is None:
            first, last = part
            result[:, first:last] = _pool_rows(
                first, last, cols, rim, inverse, steps, kernel, spread, spectral, trust, information
            )
            return
        sizes = POOL_SIZES.pack(
            first_row=part[0],
            end_row=part[1],
            rows=rows,
            cols=cols,
            rim=rim,
            groups=len(roots),
            planes=planes,
            spectral=spectral,
        )
        native.pool(
            *POOL.arguments(
                sizes=sizes,
                limits=POOL_LIMITS.pack(color=inverse[0], depth_color=inverse[1], depth=inverse[2]),
                steps=steps,
                kernel=kernel,
                **dict(zip(("roots", "delays", "valid", "data"), spread, strict=True)),
                trust=trust,
                information=information,
                active=np.ascontiguousarray(active, np.uint8),
                result=result,
            )
        )

    in_parts(some_rows, rows, 4 * threads if threads > 1 else 1, threads)
    return Pooled(result[:planes], *result[planes:])


def _pool_rows(
    first: int,
    last: int,
    cols: int,
    rim: int,
    inverse: Floats,
    steps: NDArray[np.int32],
    kernel: Floats,
    spread: list[Floats],
    spectral: int,
    trust: Floats,
    information: Floats,
) -> Floats:
    """Compute rows of `pool`: the NumPy definition."""

    def moved(values: Floats, row: int, col: int) -> Floats:
        return values[
            ..., first + rim + row : last + rim + row, rim + col : rim + col + cols
        ]  # fmt: skip

    def weight(rest: Floats) -> Floats:
        return np.clip(2 * rest, 0, 1)

    roots, delays, valid, data = spread
    here, delay = moved(roots, 0, 0), moved(delays, 0, 0)
    sums = np.zeros((len(data) + 3, last - first, cols), np.float32)
    for (row, col), near in zip(steps, kernel, strict=True):
        apart = ((moved(roots, row, col) - here) ** 2).sum(axis=0) * trust[first:last]
        away = (moved(delays, row, col) - delay) ** 2 * information[first:last] * inverse[2]
        most = near * moved(valid, row, col)
        alike = most * weight(1 - apart * inverse[0] - away)
        level = most * weight(1 - apart * inverse[1] - away)
        there = moved(data, row, col)
        sums[:spectral] += alike * there[:spectral]
        sums[spectral:-3] += level * there[spectral:]
        sums[-3] += alike
        sums[-2] += alike**2
        sums[-1] += level**2
    return sums
