# SPDX-License-Identifier: Apache-2.0
"""Check of the histograms that users hand in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.errors import HistogramError
from hueflight.model.instrument import Instrument


def check_histogram(
    counts: ArrayLike, instrument: Instrument, *, name: str = "histogram"
) -> NDArray[Any]:
    """Convert counts to an array after checking that the instrument can have made them.

    Parameters
    ----------
    counts : array_like, shape (row, col, code)
        The counts. Codes that no photon of the period can have may be missing at the end.
    instrument : Instrument
        Instrument that made them.
    name : str
        Name of the argument in errors.

    Returns
    -------
    ndarray, shape (row, col, code)
        The counts in their own type, with all codes of the sensor.

    Raises
    ------
    HistogramError
        If shape or type do not fit, a count is masked, negative or not finite, or all are 0.
    """
    if np.ma.is_masked(counts):
        masked = int(np.ma.count_masked(counts))
        raise HistogramError(
            f"{name} has {masked} masked counts, which have no defined value: replace them first, "
            "for example by .filled(0), or leave the pixels out"
        )
    array = _with_all_codes(np.asarray(counts), instrument)
    expected = instrument.histogram_shape
    if array.shape != expected:
        raise HistogramError(
            f"{name} has shape {array.shape}; instrument {instrument.name!r} makes "
            f"(row, col, code) = {expected}. {_shape_advice(array.shape, expected)}"
        )
    if array.dtype.kind not in "uif":
        raise HistogramError(f"{name} has type {array.dtype}: counts must be numbers")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise HistogramError(f"{name}[{where}] is {array[where]}: counts must be finite")
    if array.dtype.kind in "if" and array.min() < 0:
        where = tuple(int(i) for i in np.unravel_index(array.argmin(), array.shape))
        raise HistogramError(f"{name}[{where}] is {array[where]}: counts can't be negative")
    if not array.any():
        raise HistogramError(
            f"{name} is empty: not one frame was counted. Check that the capture ran and that "
            "the right recording or slice was read"
        )
    return array


def as_native(counts: ArrayLike) -> NDArray[Any]:
    """Convert counts to an array that compiled kernels can read, which few have to be copied for.

    Parameters
    ----------
    counts : array_like
        Counts in any byte order and alignment.

    Returns
    -------
    ndarray
        The counts, aligned and in the byte order of the machine.
    """
    array = np.require(counts, requirements="A")
    if array.dtype.kind not in "uif":
        return array
    native = array.dtype.newbyteorder("=")
    return array.view(native) if array.dtype.isnative else array.astype(native)


def frames_per_pixel(
    counts: NDArray[Any], instrument: Instrument, frames: ArrayLike | None
) -> NDArray[np.float64] | None:
    """Determine the number of exposures behind each pixel's counts.

    Parameters
    ----------
    counts : ndarray, shape (row, col, code)
        Checked counts.
    instrument : Instrument
        Instrument that made them.
    frames : array_like or None
        Number of exposures, one for all pixels or an array (row, col). None to take the sum over
        codes, if the sensor reports its empty exposures.

    Returns
    -------
    ndarray of float, shape (row, col), or None
        Exposures; None where their number can't be known.

    Raises
    ------
    HistogramError
        If `frames` is not finite and above 0.
    """
    if frames is not None:
        given = np.broadcast_to(np.asarray(frames, dtype=np.float64), instrument.image_shape)
        if not (np.isfinite(given).all() and (given > 0).all()):
            raise HistogramError(f"frames = {frames!r}: must be above 0 and finite")
        return given
    if not instrument.sensor.reports_empty:
        return None
    return counts.sum(axis=-1, dtype=np.float64)


def counters_full(counts: NDArray[Any]) -> NDArray[np.bool_]:
    """Find pixels that have a counter at the maximum of its integer type, which may have saturated.

    Parameters
    ----------
    counts : ndarray, shape (row, col, code)
        Counts in the type in which they were accumulated.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True where a counter may have saturated; False everywhere for floating-point counts.
    """
    if counts.dtype.kind == "f":
        return np.zeros(counts.shape[:2], dtype=bool)
    return (counts == np.iinfo(counts.dtype).max).any(axis=-1)


def _with_all_codes(array: NDArray[Any], instrument: Instrument) -> NDArray[Any]:
    """Append zeros for the codes after those that the period needs, if the array ends before."""
    expected = instrument.histogram_shape
    if array.ndim != 3 or array.shape[:2] != expected[:2]:
        return array
    codes = array.shape[2]
    if not int(instrument.time_bins().codes.max()) < codes < expected[2]:
        return array
    return np.pad(array, ((0, 0), (0, 0), (0, expected[2] - codes)))


def _shape_advice(shape: tuple[int, ...], expected: tuple[int, ...]) -> str:
    if sorted(shape) == sorted(expected):
        return (
            "The axes seem to be in another order: transpose them, or name the axes of the file "
            "(--axes)"
        )
    if len(shape) == 3 and shape[:2] == expected[:2]:
        return "The number of codes differs: check sensor.code_bits"
    if len(shape) == 3 and shape[2] == expected[2]:
        return "The number of pixels differs: check sensor.rows, cols and scan_steps"
    return "Check that the histogram belongs to this instrument"
