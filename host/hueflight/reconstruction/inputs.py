# SPDX-License-Identifier: Apache-2.0
"""Check a histogram and prepare it for the methods, in one pass over its counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.errors import CalibrationError, HistogramError
from hueflight.fit.solver import COUNT_TYPES, Survey, survey
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
    histogram: ArrayLike | StoredCounts,
    calibration: Calibration,
    frames: ArrayLike | None,
    *,
    look: Callable[[NDArray[Any], slice], Survey] = survey,
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
        empty exposures, else as many as the reference had.
    look : callable
        Reads whole counts in memory as `survey` does, for who has more to look for.

    Returns
    -------
    PreparedHistogram
        The counts, checked and in time order.

    Raises
    ------
    HistogramError
        If it does not fit the calibration's instrument, or is empty.
    CalibrationError
        If the calibration has no brightness or gain of a band.
    """
    instrument = calibration.instrument
    _require_bright(calibration)
    if isinstance(histogram, StoredCounts):
        return _prepare_stored(histogram, calibration, frames)
    counts = as_native(histogram)
    if _surveyed_at_once(counts, calibration):
        shape = counts.shape[:2]
        flat = counts.reshape(-1, counts.shape[2])
        flat_sums, flat_photons, flat_full = look(flat, _lit_codes(calibration))
        sums, photons, full = (
            flat_sums.reshape(shape),
            flat_photons.reshape(shape),
            flat_full.reshape(shape),
        )
        if not sums.any():
            check_histogram(counts, instrument)  # says so
        known = frames is None and instrument.sensor.reports_empty
        exposures = sums if known else assumed_exposures(counts, calibration, frames)
    else:
        counts = check_histogram(counts, instrument)
        exposures, full = assumed_exposures(counts, calibration, frames), counters_full(counts)
        photons = None
    light = calibration.bins.in_time_order(counts)
    if light.dtype not in COUNT_TYPES:
        light = light.astype(np.float32)
    if photons is None:
        photons = light.sum(axis=-1, dtype=np.float64)
    return PreparedHistogram(counts, light, photons, exposures, full)


def prepare_pixels(
    histogram: ArrayLike,
    calibration: Calibration,
    frames: ArrayLike | None,
    before: PreparedHistogram,
    chosen: NDArray[np.bool_],
) -> PreparedHistogram:
    """Prepare the chosen pixels of another histogram; counts of the others are not read.

    Parameters
    ----------
    histogram : array_like, shape (row, col, code)
        Counts, raw codes on the last axis.
    calibration : Calibration
        Calibration of the same instrument.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the histogram; see `prepare_histogram`.
    before : PreparedHistogram
        An earlier histogram of the same instrument.
    chosen : ndarray of bool, shape (row, col)
        Pixels to look at.

    Returns
    -------
    PreparedHistogram
        The counts, with what was found of the chosen pixels; of the others, what `before` has.

    Raises
    ------
    HistogramError
        If the histogram does not fit the calibration's instrument.
    """
    counts = as_native(histogram)
    if not _surveyed_at_once(counts, calibration):
        return prepare_histogram(histogram, calibration, frames)
    flat, pixels = counts.reshape(-1, counts.shape[2]), np.flatnonzero(chosen)
    sums, photons, full = survey(flat, _lit_codes(calibration), pixels=pixels)

    def renewed(old: NDArray[Any], values: NDArray[Any]) -> NDArray[Any]:
        new = old.copy()
        new[chosen] = values
        return new

    if frames is None and calibration.instrument.sensor.reports_empty:
        assert before.exposures is not None  # such a sensor's exposures are always known
        exposures = renewed(before.exposures, sums)
    else:
        exposures = assumed_exposures(counts, calibration, frames)
    return PreparedHistogram(
        counts,
        calibration.bins.in_time_order(counts),
        renewed(before.photons, photons),
        exposures,
        renewed(before.full, full),
    )


def _surveyed_at_once(counts: NDArray[Any], calibration: Calibration) -> bool:
    """Whether counts are of the right shape, and of types that the kernels read."""
    shape = calibration.instrument.histogram_shape
    return counts.shape == shape and counts.dtype in (np.uint16, np.uint32)


def _lit_codes(calibration: Calibration) -> slice:
    """Codes of the calibration's time bins, which are a run of them either way."""
    codes = calibration.bins.codes
    return slice(int(codes.min()), int(codes.max()) + 1)


def assumed_exposures(
    counts: NDArray[Any], calibration: Calibration, frames: ArrayLike | None
) -> NDArray[np.float64] | None:
    """Exposures behind counts: known, or as many as the reference had, or None."""
    known = frames_per_pixel(counts, calibration.instrument, frames)
    return calibration.frames if known is None else known


def _require_bright(calibration: Calibration) -> None:
    """Refuse a calibration by which the light of a band says nothing of its reflectance."""
    for band, brightness, gain in zip(
        calibration.instrument.bands, calibration.brightness, calibration.gain, strict=True
    ):
        if not (0 < brightness < np.inf and 0 < gain < np.inf):
            raise CalibrationError(
                f"the calibration has a brightness of {brightness:g} and a gain of {gain:g} for "
                f"band {band.name!r}: its LED was dark. Calibrate again with all LEDs on, or with "
                "an instrument without that band"
            )


def _prepare_stored(
    stored: StoredCounts, calibration: Calibration, frames: ArrayLike | None
) -> PreparedHistogram:
    instrument = calibration.instrument
    if stored.source.shape != instrument.histogram_shape:
        check_histogram(np.asarray(stored.source[:1]), instrument)  # says what differs
    sums, photons = np.empty((2, *instrument.image_shape))
    full = np.empty(instrument.image_shape, bool)
    lit = _lit_codes(calibration)
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
    exposures = sums if known else assumed_exposures(sums, calibration, frames)
    return PreparedHistogram(stored.source, stored, photons, exposures, full)
