"""What comes in at the door: a histogram checked, its exposures and full counters, in one pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.fit.solver import COUNT_TYPES, survey
from hueflight.model.histograms import check_histogram, counters_full, frames_per_pixel


@dataclass(frozen=True)
class PreparedHistogram:
    """A histogram that fits its instrument.

    Attributes
    ----------
    counts : (row, col, code).
    light : (row, col, bin) in time order, of a type that the fit reads.
    photons : (row, col) counts of the light.
    frames : (row, col) exposures, or None where it can't be known.
    full : (row, col) a counter is at its end.
    """

    counts: NDArray[Any]
    light: NDArray[Any]
    photons: NDArray[np.float64]
    frames: NDArray[np.float64] | None
    full: NDArray[np.bool_]


def prepare_histogram(
    histogram: ArrayLike, calibration: Calibration, frames: ArrayLike | None
) -> PreparedHistogram:
    """Check a histogram and see what is behind it.

    Raises
    ------
    HistogramError
        If it does not fit the calibration's instrument, or is empty.
    """
    instrument = calibration.instrument
    counts = np.asarray(histogram)
    if counts.shape == instrument.histogram_shape and counts.dtype in (np.uint16, np.uint32):
        codes = calibration.bins.codes  # a run of them, either way
        lit = slice(int(codes.min()), int(codes.max()) + 1)
        shape = counts.shape[:2]
        flat_sums, flat_photons, flat_full = survey(counts.reshape(-1, counts.shape[2]), lit)
        sums, photons, full = (
            flat_sums.reshape(shape),
            flat_photons.reshape(shape),
            flat_full.reshape(shape),
        )
        if not sums.any():
            check_histogram(counts, instrument)  # says so
        known = frames is None and instrument.sensor.reports_empty
        exposures = sums if known else frames_per_pixel(counts, instrument, frames)
    else:
        counts = check_histogram(counts, instrument)
        exposures, full = frames_per_pixel(counts, instrument, frames), counters_full(counts)
        photons = None
    light = calibration.bins.in_time_order(counts)
    if light.dtype not in COUNT_TYPES:
        light = light.astype(np.float32)
    if photons is None:
        photons = light.sum(axis=-1, dtype=np.float64)
    return PreparedHistogram(counts, light, photons, exposures, full)
