# SPDX-License-Identifier: Apache-2.0
"""The inverse-square law: from the signal relative to the reference target to reflectance.

A surface twice as far away as the reference target returns a quarter of its light. Whether the
reflectances of an image were corrected for that stands in the attribute `range_correction` of the
variable `reflectance`, so that no one has to guess.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError

LONG_NAMES = {
    True: "reflectance relative to the reference target",
    False: "signal relative to the reference target, not corrected for the distance",
}


def resolve(
    wanted: bool | None, calibration: Calibration, *, honors: frozenset[str] | None = None
) -> bool:
    """Decide whether reflectance is corrected for the distance.

    Parameters
    ----------
    wanted : bool or None
        What the caller asked for; None to correct wherever that is possible.
    calibration : Calibration
        Calibration, whose distance is 0 where that of the reference is not known.
    honors : frozenset of str or None
        Options that the method takes into account; None for all.

    Returns
    -------
    bool
        True to correct.

    Raises
    ------
    HueflightError
        If the correction was asked for and the distance of the reference is not known.
    """
    if wanted and not calibration.distance > 0:
        raise HueflightError(
            "range_correction = True: the calibration was made with distance = 0, so the "
            "distance of the reference is not known; calibrate with the distance of the target"
        )
    if wanted is None:
        honored = honors is None or "range_correction" in honors
        return honored and calibration.distance > 0
    return wanted


def relative_range(depth: NDArray[np.float64], calibration: Calibration) -> NDArray[np.float64]:
    """Compute the distance relative to that of the reference; the angle of the ray cancels.

    Parameters
    ----------
    depth : ndarray of float, shape (row, col)
        Depth, m.
    calibration : Calibration
        Calibration with the distance of the reference.

    Returns
    -------
    ndarray of float, shape (row, col)
        The ratio; NaN where the distance of the reference is not known.
    """
    return depth / calibration.distance if calibration.distance > 0 else np.full_like(depth, np.nan)


def widened(
    deviation: NDArray[np.floating],
    reflectance: NDArray[np.floating],
    depth: NDArray[np.floating],
    depth_std: NDArray[np.floating],
) -> NDArray[np.floating]:
    """Add the uncertainty of the distance to that of a corrected reflectance.

    The correction multiplies by the square of the distance, so that the relative deviation of the
    distance counts twice.

    Parameters
    ----------
    deviation : ndarray of float, shape (band, row, col)
        Standard deviation of the corrected reflectance by photon noise.
    reflectance : ndarray of float, shape (band, row, col)
        Corrected reflectance.
    depth, depth_std : ndarray of float, shape (row, col)
        Depth and its standard deviation, m.

    Returns
    -------
    ndarray of float, shape (band, row, col)
        Standard deviation by both.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # no depth, no reflectance
        by_range = reflectance * (2 * depth_std / np.abs(depth))
        return np.sqrt(deviation**2 + by_range**2)


def attributes(corrected: bool) -> dict[str, str]:
    """Return the attributes of `reflectance` that state the correction.

    Parameters
    ----------
    corrected : bool
        Whether it was corrected.

    Returns
    -------
    dict of str to str
        `range_correction`, ``"inverse square"`` or ``"none"``, and the matching `long_name`.
    """
    name = "inverse square" if corrected else "none"
    return {"range_correction": name, "long_name": LONG_NAMES[corrected]}


def range_correction_of(image: xr.Dataset) -> str | None:
    """Return what an image states about the range correction of its reflectances.

    Parameters
    ----------
    image : Dataset
        An image, or spectra made from one.

    Returns
    -------
    str or None
        ``"inverse square"``, ``"none"``, or None if it does not say. Images of version 0.1.0 do
        not say; they were not corrected unless that was asked for.
    """
    stated = image["reflectance"].attrs.get("range_correction")
    return None if stated is None else str(stated)


def relative_signal(
    image: xr.Dataset, calibration: Calibration
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Compute the signal relative to the reference, whether the image was corrected or not.

    Parameters
    ----------
    image : Dataset
        A single image.
    calibration : Calibration
        Calibration that it was made with.

    Returns
    -------
    signal : ndarray of float, shape (band, row, col)
        Reflectance without range correction.
    signal_std : ndarray of float, shape (band, row, col)
        Its standard deviation by photon noise.
    """
    planes = image.transpose("band", "row", "col")
    reflectance = planes["reflectance"].values.astype(np.float64)
    deviation = planes["reflectance_std"].values.astype(np.float64)
    if range_correction_of(image) in (None, "none"):
        return reflectance, deviation
    depth = planes["depth"].values.astype(np.float64)
    return uncorrected(reflectance, deviation, depth, planes["depth_std"].values, calibration)


def uncorrected(
    reflectance: NDArray[np.floating],
    deviation: NDArray[np.floating],
    depth: NDArray[np.float64],
    depth_std: NDArray[np.floating],
    calibration: Calibration,
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Undo the correction for the distance, and `widened`.

    Parameters
    ----------
    reflectance, deviation : ndarray of float, shape (band, row, col)
        Corrected reflectance and its standard deviation.
    depth, depth_std : ndarray of float, shape (row, col)
        Depth and its standard deviation, m.
    calibration : Calibration
        Calibration with the distance of the reference.

    Returns
    -------
    signal : ndarray of float, shape (band, row, col)
        Reflectance without range correction.
    signal_std : ndarray of float, shape (band, row, col)
        Its standard deviation by photon noise.
    """
    by_range = 2 * reflectance * depth_std / np.abs(depth)
    factor = relative_range(depth, calibration) ** 2
    return reflectance / factor, np.sqrt((deviation**2 - by_range**2).clip(0)) / factor


def require_same_range_correction(images: Sequence[xr.Dataset]) -> None:
    """Check that the reflectances of images can be compared.

    Images that do not state their correction are taken for uncorrected ones.

    Parameters
    ----------
    images : sequence of Dataset
        The images.

    Raises
    ------
    HueflightError
        If some are corrected for the distance and others are not.
    """
    stated = [range_correction_of(image) for image in images]
    for number, correction in enumerate(stated):
        if (correction or "none") != (stated[0] or "none"):
            raise HueflightError(
                f"the reflectance of image {number} has range_correction "
                f"{correction or 'not stated'!r}, that of image 0 {stated[0] or 'not stated'!r}: "
                "reconstruct both alike, with range_correction=True or range_correction=False"
            )
