"""Codes and histograms drawn from p(code)."""

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
    """Counts of many exposures at once, by one multinomial draw for each pixel.

    Parameters
    ----------
    frames : exposures; each pixel's counts sum to it where the sensor reports empty exposures.
    settings : light level and imperfections.
    seed : of the photon noise, one or several numbers.

    Returns
    -------
    (row, col, code), uint16 where `frames` fits, else uint32.

    Raises
    ------
    SceneError
        If the scene does not fit the instrument or `frames` is not 1 … 2³² − 1.
    """
    _check_frames(frames)
    rates = expected_rates(scene, instrument, settings)
    rng = _generator(seed, 3)
    dtype = np.uint16 if frames <= np.iinfo(np.uint16).max else np.uint32
    histogram = np.empty(instrument.histogram_shape, dtype=dtype)
    for rows, probabilities in probability_tiles(rates):
        # what is no code is the empty exposure, last so that it takes the rounding
        if instrument.sensor.reports_empty:
            outcomes = np.roll(probabilities, -1, axis=-1)
            counts = np.roll(rng.multinomial(frames, outcomes), 1, axis=-1)
        else:
            rest = np.maximum(0, 1 - probabilities.sum(axis=-1, keepdims=True))
            counts = rng.multinomial(frames, np.concatenate([probabilities, rest], axis=-1))
            counts = counts[..., :-1]
        histogram[rows] = counts
    return histogram


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
    """Codes frame by frame: every pixel of every exposure is drawn on its own.

    Parameters
    ----------
    frames : how many.
    seed : of the photon noise, one or several numbers.
    rows : which rows of the image, e.g. one scan step; all by default.
    block_frames : frames per block.

    Yields
    ------
    (frame, row, col) uint16, at most `block_frames` frames each.

    Raises
    ------
    SceneError
        If the scene does not fit the instrument, the sensor has no code for an empty exposure,
        or `frames` is not positive.
    """
    require_codes(instrument)
    _check_frames(frames)
    rates = expected_rates(scene, instrument, settings).rows(rows)
    return _draw_codes(rates, frames, _generator(seed, 4), block_frames)


def _draw_codes(
    rates: Rates, frames: int, rng: np.random.Generator, block_frames: int
) -> Iterator[NDArray[np.uint16]]:
    rows, cols = rates.shape
    thresholds = _thresholds(rates).reshape(rows * cols, -1)
    # past the last threshold lies the empty exposure, code 0
    code_of_bin = np.append(rates.bins.codes, 0).astype(np.uint16)
    for start in range(0, frames, block_frames):
        count = min(block_frames, frames - start)
        draws = rng.integers(0, _FULL_SCALE, (rows * cols, count), dtype=np.uint32)
        codes = np.empty((rows * cols, count), dtype=np.uint16)
        for pixel in range(rows * cols):
            found = np.searchsorted(thresholds[pixel], draws[pixel], side="right")
            codes[pixel] = code_of_bin[found]
        yield np.ascontiguousarray(codes.T).reshape(count, rows, cols)


def _thresholds(rates: Rates) -> NDArray[np.uint32]:
    """Cumulative probability over bins in time order, (row, col, bin), in units of 2⁻³²."""
    result = np.empty((*rates.shape, rates.bins.count), dtype=np.uint32)
    for rows, probabilities in probability_tiles(rates):
        cumulative = np.cumsum(probabilities[..., rates.bins.codes], axis=-1)
        result[rows] = np.minimum(cumulative * _FULL_SCALE, _FULL_SCALE - 1)
    return result


def require_codes(instrument: Instrument) -> None:
    """Raise `SceneError` unless the sensor can deliver codes frame by frame."""
    if not instrument.sensor.reports_empty:
        raise SceneError(
            f"instrument {instrument.name!r} has no code for an empty exposure "
            '(sensor.code_zero = "bin"), so it can\'t deliver codes frame by frame: '
            "simulate its histogram"
        )


def _generator(seed: int | Sequence[int], purpose: int) -> np.random.Generator:
    """Random numbers of their own for each purpose, so that the samplers share none."""
    numbers = [seed] if isinstance(seed, int) else list(seed)
    if any(number < 0 for number in numbers):
        raise SceneError(f"seed = {seed!r}: must not be negative")
    return np.random.default_rng([*numbers, purpose])


def _check_frames(frames: int) -> None:
    if not 1 <= frames < _FULL_SCALE:
        raise SceneError(f"frames = {frames}: must be 1 … {_FULL_SCALE - 1}")
