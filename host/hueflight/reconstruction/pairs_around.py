# SPDX-License-Identifier: Apache-2.0
"""Pixels that see the same two surfaces as their neighbors, but too faintly to tell alone.

A pixel by itself has to find two delays and two spectra among all there are, so that only a large
gain in likelihood rules out chance. Where pixels around it show two surfaces, one question is left:
whether these two explain its counts better than any single one. What it then states is a fit to its
own counts, begun at the pair of its neighbors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.surfaces import Surfaces, dense_rows
from hueflight.fit.tables import ModelTables
from hueflight.fit.two_returns import TwoReturns, fit_from_pairs, one_surface_likelihood
from hueflight.reconstruction.edge_fit import greatest_likelihood, waveforms
from hueflight.reconstruction.fitted_picture import FittedPicture
from hueflight.reconstruction.told_apart import told_apart

REACH = 2  #: rows and columns to either side
FEWEST = 3  #: neighbors that have to agree
AGREE = 3.0  #: standard deviations by which a neighbor's delays may differ from the median
LEAST_GAIN = 9.0  #: twice the log-likelihood that the dimmer surface must add to the other one
MOST_ROUNDS = 16  #: in each of which a region grows by two rows and columns at most
CHUNK = 1024  #: pixels that are asked together, which bounds the memory it takes

_Floats = NDArray[np.float64]
_Numbers = NDArray[np.intp]


def with_neighbors(
    numbers: _Numbers, found: TwoReturns, free: NDArray[np.bool_], picture: FittedPicture
) -> tuple[_Numbers, TwoReturns]:
    """Add the pixels whose counts need the two surfaces that pixels around them show.

    Parameters
    ----------
    numbers : ndarray of int, shape (pixel,)
        Numbers of pixels that see two surfaces, row by row, in any order.
    found : TwoReturns
        Their fits.
    free : ndarray of bool, shape (row, col)
        Pixels that may be added.
    picture : FittedPicture
        The picture.

    Returns
    -------
    numbers : ndarray of int
        The same, and those that were added.
    found : TwoReturns
        Their fits.
    """
    asked = np.zeros(free.shape, np.int64)  # neighbors with two surfaces when it was last asked
    for _ in range(MOST_ROUNDS):
        member = np.full(free.shape, -1)
        member.ravel()[numbers] = np.arange(numbers.size)
        around = _around(member)
        count = (around >= 0).sum(axis=-1)
        due = np.flatnonzero(free & (member < 0) & (count >= FEWEST) & (count > asked))
        asked = count
        added = [
            _seen(part, around.reshape(-1, around.shape[-1])[part], found, picture)
            for part in np.split(due, range(CHUNK, due.size, CHUNK))
            if part.size
        ]
        if not sum(new.size for new, _ in added):
            break
        numbers = np.concatenate([numbers, *(new for new, _ in added)])
        found = TwoReturns.joined([found, *(fit for _, fit in added)])
    return numbers, found


def _around(member: _Numbers) -> _Numbers:
    """Members (row, col, neighbor) around each pixel, −1 where there is none."""
    rows, cols = member.shape
    padded = np.pad(member, REACH, constant_values=-1)
    window = range(2 * REACH + 1)
    return np.stack(
        [
            padded[row : row + rows, col : col + cols]
            for row in window
            for col in window
            if (row, col) != (REACH, REACH)
        ],
        axis=-1,
    )


def _seen(
    numbers: _Numbers, around: _Numbers, found: TwoReturns, picture: FittedPicture
) -> tuple[_Numbers, TwoReturns]:
    """Which pixels see the pair of their neighbors (pixel, neighbor), and their fits."""
    tables = picture.fitted.tables
    delays, amplitudes, agree = _pairs(around, found)
    if not agree.any():
        return numbers[agree], found.take(np.flatnonzero(agree))
    numbers, delays, amplitudes = numbers[agree], delays[agree], amplitudes[agree]
    light = picture.light(numbers)
    one = picture.pixels(numbers, light)
    arrivals = delays + one.offset_ns[:, None]
    single = one_surface_likelihood(light, one.arrival_ns, one.amplitudes, one.background, tables)
    # the brighter surface may lie elsewhere than that of the neighbors: where one surface fits best
    rows, brighter = np.arange(numbers.size), amplitudes.sum(axis=-1).argmax(axis=1)
    own = arrivals.copy()
    own[rows, brighter] = one.arrival_ns
    gains = [
        2 * (_with_the_dimmer(one.counts, pair, brighter, amplitudes, tables) - single)
        for pair in (arrivals, own)
    ]
    arrivals = np.where((gains[1] > gains[0])[:, None], own, arrivals)
    seen = np.flatnonzero(np.maximum(*gains) > LEAST_GAIN)
    if not seen.size:
        return numbers[seen], found.take(seen)
    scale = one.counts.sum(axis=-1) / amplitudes.sum(axis=(1, 2))
    start = Surfaces(arrivals, scale[:, None, None] * amplitudes, one.background)
    fit = fit_from_pairs(light[seen], one.offset_ns[seen], tables, start.take(seen))
    kept = told_apart(fit, tables)
    return numbers[seen[kept]], fit.take(kept)


def _with_the_dimmer(
    counts: _Floats,
    arrivals: _Floats,
    brighter: _Numbers,
    amplitudes: _Floats,
    tables: ModelTables,
) -> _Floats:
    """Log-likelihood of the dimmer surface with its spectrum, and of any spectrum of the other."""
    level, rows = tables.wide, np.arange(len(counts))
    phases = level.phase_of(arrivals[rows, brighter])
    bands = dense_rows(phases, level, level.tiles.shares).astype(np.float64)
    dimmer = waveforms(level, arrivals[rows, 1 - brighter], amplitudes[rows, 1 - brighter])
    flat = np.broadcast_to(level.widths, counts.shape).astype(np.float64)
    return greatest_likelihood(counts, [dimmer, *bands.transpose(1, 0, 2), flat])


def _pairs(around: _Numbers, found: TwoReturns) -> tuple[_Floats, _Floats, NDArray[np.bool_]]:
    """Delays (pixel, 2), amplitudes (pixel, 2, band) of neighbors, and where enough agree."""
    there = around >= 0
    delays = np.where(there[..., None], found.delay_ns[around], np.nan)
    middle = np.nanmedian(delays, axis=1)
    off = np.abs(delays - middle[:, None]) / found.delay_std_ns[around]
    agree = there & (off < AGREE).all(axis=-1)
    weight = agree / np.maximum(agree.sum(axis=1), 1)[:, None]
    amplitudes = np.einsum("pn,pnsk->psk", weight, found.amplitudes[around])
    return middle, np.maximum(amplitudes, 0.0), agree.sum(axis=1) >= FEWEST
