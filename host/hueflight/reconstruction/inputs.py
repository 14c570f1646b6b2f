# SPDX-License-Identifier: Apache-2.0
"""Check a histogram and prepare it for the methods, in one pass over its counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError
from hueflight.fit.solver import COUNT_TYPES, survey
from hueflight.model.histograms import as_native, check_histogram, counters_full, frames_per_pixel
from hueflight.reconstruction.stored_counts import StoredCounts


@dataclass(frozen=True)
class PreparedHistogram:
    """A histogram that fits its instrument, as every method receives it.

    Attributes
    ----------
    counts : ndarray or StoredArray, shape (row, col, code)
        The histogram itself, raw codes on the last axis.
    light : ndarray of uint16, uint32 or float32, or StoredCounts, shape (row, col, bin)
        The same counts in time order, without codes that stand for no photon. They stay on disk
        where the method says that it `reads_stored` counts.
    photons : ndarray of float64, shape (row, col)
        Sums of `light`.
    exposures : ndarray of float64, shape (row, col), or None
        Exposures behind each pixel, where they are known.
    full : ndarray of bool, shape (row, col)
        True where a counter is at the end of its type.
    """

    counts: Any
    light: Any
    photons: NDArray[np.float64]
    exposures: NDArray[np.float64] | None
    full: NDArray[np.bool_]


def prepare_histogram(
    histogram: ArrayLike | StoredCounts, calibration: Calibration, frames: ArrayLike | None
) -> PreparedHistogram:
    """Check a histogram and prepare it.

    Parameters
    ----------
    histogram : array_like or StoredCounts, shape (row, col, code)
        Counts, raw codes on the last axis. Stored counts stay on disk and are surveyed in blocks.
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
    if isinstance(histogram, StoredCounts):
        return _prepare_stored(histogram, calibration, frames)
    counts = as_native(histogram)
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


def _prepare_stored(
    stored: StoredCounts, calibration: Calibration, frames: ArrayLike | None
) -> PreparedHistogram:
    instrument = calibration.instrument
    if stored.source.shape != instrument.histogram_shape:
        check_histogram(np.asarray(stored.source[:1]), instrument)  # says what differs
    sums, photons = np.empty((2, *instrument.image_shape))
    full = np.empty(instrument.image_shape, bool)
    codes = calibration.bins.codes
    lit = slice(int(codes.min()), int(codes.max()) + 1)
    for rows, counts in stored.blocks():
        if counts.dtype.kind not in "uif" or not (counts >= 0).all():
            raise HistogramError(
                f"the histogram's rows {rows.start} to {rows.stop - 1} hold counts of type "
                f"{counts.dtype} that are negative or not finite: counts must be numbers from 0 on"
            )
        found = survey(counts.reshape(-1, counts.shape[-1]), lit)
        for plane, values in zip((sums, photons, full), found, strict=True):
            plane[rows] = values.reshape(counts.shape[:2])
    if not sums.any():
        raise HistogramError(
            "the histogram is empty: not one frame was counted. Check that the capture ran and "
            "that the right recording or slice was read"
        )
    known = frames is None and instrument.sensor.reports_empty
    exposures = sums if known else frames_per_pixel(sums, instrument, frames)
    return PreparedHistogram(stored.source, stored, photons, exposures, full)
