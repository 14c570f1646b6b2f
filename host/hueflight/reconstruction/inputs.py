"""Check a histogram and prepare it for the methods, in one pass over its counts."""

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
    """A histogram that fits its instrument, as every method receives it.

    Attributes
    ----------
    counts : ndarray, shape (row, col, code)
        The histogram itself, raw codes on the last axis.
    light : ndarray of uint16, uint32 or float32, shape (row, col, bin)
        The same counts in time order, without codes that stand for no photon.
    photons : ndarray of float64, shape (row, col)
        Sums of `light`.
    exposures : ndarray of float64, shape (row, col), or None
        Exposures behind each pixel, where they are known.
    full : ndarray of bool, shape (row, col)
        True where a counter is at the end of its type.
    """

    counts: NDArray[Any]
    light: NDArray[Any]
    photons: NDArray[np.float64]
    exposures: NDArray[np.float64] | None
    full: NDArray[np.bool_]


def prepare_histogram(
    histogram: ArrayLike, calibration: Calibration, frames: ArrayLike | None
) -> PreparedHistogram:
    """Check a histogram and prepare it.

    Parameters
    ----------
    histogram : array_like, shape (row, col, code)
        Counts, raw codes on the last axis.
    calibration : Calibration
        Calibration of the same instrument.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the histogram; by default the sum over codes where the sensor reports its
        empty exposures, else unknown.

    Returns
    -------
    PreparedHistogram
        The counts, checked and in time order.

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
