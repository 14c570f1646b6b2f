# SPDX-License-Identifier: Apache-2.0
"""Codes and histograms drawn at random from the probabilities of codes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import SceneError
from hueflight.model.instrument import Instrument
from hueflight.simulator.light import Rates, expected_rates
from hueflight.simulator.probabilities import probability_tiles
from hueflight.simulator.scene import Scene
from hueflight.simulator.settings import SimulationSettings

_FULL_SCALE = 2**32


def simulate_histogram(
    scene: Scene,
    instrument: Instrument,
    *,
    frames: int,
    settings: SimulationSettings | None = None,
    seed: int | Sequence[int] = 0,
) -> NDArray[np.unsignedinteger]:
    """Simulate the histograms of many exposures by one multinomial draw for each pixel.

    Parameters
    ----------
    scene : Scene
        Scene laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at the scene.
    frames : int
        Number of exposures; the counts of a pixel sum to it if the sensor reports empty ones.
    settings : SimulationSettings or None
        Light level and imperfections; None for the defaults.
    seed : int or sequence of int
        Seed of the photon noise.

    Returns
    -------
    ndarray of uint16 or uint32, shape (row, col, code)
        Number of exposures with each code; uint16 up to 65535 frames.

    Raises
    ------
    SceneError
        If the scene does not fit the instrument, `frames` is not from 1 to 2³² − 1, or a seed is
        negative.
    """
    _check_frames(frames)
    rng = _generator(seed, 3)
    dtype = np.uint16 if frames <= np.iinfo(np.uint16).max else np.uint32
    histogram = np.zeros(instrument.histogram_shape, dtype=dtype)
    for moment, count in _moments(scene, frames):
        rates = expected_rates(moment, instrument, settings)
        _add_histogram(histogram, rates, count, rng)
    return histogram


def _add_histogram(
    histogram: NDArray[np.unsignedinteger], rates: Rates, frames: int, rng: np.random.Generator
) -> None:
    """Draw the counts of a number of exposures and add them to a histogram (row, col, code)."""
    for rows, probabilities in probability_tiles(rates):
        # the empty exposure comes last, as the last outcome absorbs the rounding error
        if rates.instrument.sensor.reports_empty:
            outcomes = np.roll(probabilities, -1, axis=-1)
            counts = np.roll(rng.multinomial(frames, outcomes), 1, axis=-1)
        else:
            rest = np.maximum(0, 1 - probabilities.sum(axis=-1, keepdims=True))
            counts = rng.multinomial(frames, np.concatenate([probabilities, rest], axis=-1))
            counts = counts[..., :-1]
        histogram[rows] += counts.astype(histogram.dtype)


def _moments(scene: Scene, frames: int) -> Iterator[tuple[Scene, int]]:
    """Scene at each moment of a capture, and the number of frames of that moment."""
    moments = scene.moments or (scene,)
    for index, moment in enumerate(moments):
        count = frames * (index + 1) // len(moments) - frames * index // len(moments)
        if count:
            yield moment, count


def simulate_codes(
    scene: Scene,
    instrument: Instrument,
    *,
    frames: int,
    settings: SimulationSettings | None = None,
    seed: int | Sequence[int] = 0,
    rows: slice = slice(None),
    block_frames: int = 256,
) -> Iterator[NDArray[np.uint16]]:
    """Simulate codes frame by frame, each pixel of each exposure drawn separately.

    Parameters
    ----------
    scene : Scene
        Scene laid out for the same instrument.
    instrument : Instrument
        Instrument that looks at the scene.
    frames : int
        Number of exposures.
    settings : SimulationSettings or None
        Light level and imperfections; None for the defaults.
    seed : int or sequence of int
        Seed of the photon noise.
    rows : slice
        Rows of the image to simulate, for example those of one scan step; all by default. Crosstalk
        is exact for whole scan steps only: others lack the neighbors above and below.
    block_frames : int
        Largest number of frames in one block.

    Returns
    -------
    iterator of ndarray of uint16, shape (frame, row, col)
        Blocks of codes in the order of the frames.

    Raises
    ------
    SceneError
        If the scene does not fit the instrument, the sensor has no code for an empty exposure,
        `frames` is not from 1 to 2³² − 1, or a seed is negative.
    """
    require_codes(instrument)
    _check_frames(frames)
    (first, count), *later = _moments(scene, frames)
    rates = expected_rates(first, instrument, settings).rows(rows)  # errors come before any frame
    rng = _generator(seed, 4)

    def frame_blocks() -> Iterator[NDArray[np.uint16]]:
        yield from _draw_codes(rates, count, rng, block_frames)
        for moment, number in later:
            next_rates = expected_rates(moment, instrument, settings).rows(rows)
            yield from _draw_codes(next_rates, number, rng, block_frames)

    return frame_blocks()


def _draw_codes(
    rates: Rates, frames: int, rng: np.random.Generator, block_frames: int
) -> Iterator[NDArray[np.uint16]]:
    """Blocks of codes, shape (frame, row, col), by inverting the cumulative distribution."""
    thresholds = code_thresholds(rates)
    code_of_bin = np.append(rates.bins.codes, 0).astype(np.uint16)
    for start in range(0, frames, block_frames):
        found = draw_bins(thresholds, min(block_frames, frames - start), rng)
        yield np.ascontiguousarray(code_of_bin[found])


def draw_bins(
    thresholds: NDArray[np.uint32], frames: int, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """Draw the time bin of every pixel of some frames.

    Parameters
    ----------
    thresholds : ndarray of uint32, shape (row, col, bin)
        Cumulative probabilities as of `code_thresholds`.
    frames : int
        Number of frames.
    rng : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    ndarray of uint16, shape (frame, row, col)
        Index of the bin in order of arrival time; the number of bins for an empty exposure.
    """
    rows, cols, bins = thresholds.shape
    table = thresholds.reshape(rows * cols, bins)
    draws = rng.integers(0, _FULL_SCALE, (rows * cols, frames), dtype=np.uint32)
    found = np.empty((rows * cols, frames), dtype=np.uint16)
    for pixel in range(rows * cols):
        found[pixel] = np.searchsorted(table[pixel], draws[pixel], side="right")
    return found.T.reshape(frames, rows, cols)


def code_thresholds(rates: Rates) -> NDArray[np.uint32]:
    """Return the cumulative probabilities of codes, by which codes are drawn.

    Parameters
    ----------
    rates : Rates
        Photons of each pixel.

    Returns
    -------
    ndarray of uint32, shape (row, col, bin)
        Cumulative probability over bins in order of arrival time, in units of 2⁻³². A draw beyond
        the last one is an empty exposure.
    """
    result = np.empty((*rates.shape, rates.bins.count), dtype=np.uint32)
    for rows, probabilities in probability_tiles(rates):
        cumulative = np.cumsum(probabilities[..., rates.bins.codes], axis=-1)
        result[rows] = np.minimum(cumulative * _FULL_SCALE, _FULL_SCALE - 1)
    return result


def require_codes(instrument: Instrument) -> None:
    """Raise `SceneError` if the sensor has no code for an empty exposure."""
    if not instrument.sensor.reports_empty:
        raise SceneError(
            f"instrument {instrument.name!r} has no code for an empty exposure "
            '(sensor.code_zero = "bin") and cannot deliver codes frame by frame: '
            "simulate its histogram instead"
        )


def _generator(seed: int | Sequence[int], purpose: int) -> np.random.Generator:
    """Random generator for one purpose; different purposes draw independent numbers."""
    numbers = [seed] if isinstance(seed, int) else list(seed)
    if any(number < 0 for number in numbers):
        raise SceneError(f"seed = {seed!r}: must be 0 or more")
    return np.random.default_rng([*numbers, purpose])


def _check_frames(frames: int) -> None:
    """Raise `SceneError` unless the number of frames fits into a counter of 32 bits."""
    if not 1 <= frames < _FULL_SCALE:
        raise SceneError(f"frames = {frames}: must be from 1 to {_FULL_SCALE - 1}")
