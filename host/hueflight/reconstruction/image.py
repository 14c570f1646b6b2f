# SPDX-License-Identifier: Apache-2.0
"""Build the image: estimates labeled with dimensions, wavelengths and units."""

from __future__ import annotations

from functools import cache
from importlib.metadata import version
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.quality import flag_attributes
from hueflight.reconstruction.range_correction import attributes as correction_attributes

#: images without values by what their labels depend on, since making labels takes 1 ms
_labels: WeakKeyDictionary[Calibration, dict[tuple[Any, ...], xr.Dataset]] = WeakKeyDictionary()

UNITS = {
    "depth": "m",
    "depth_std": "m",
    "other_depth": "m",
    "second_depth": "m",
    "second_depth_std": "m",
    "near_share": "1",
    "near_share_std": "1",
    "reflectance": "1",
    "reflectance_std": "1",
    "near_reflectance": "1",
    "near_reflectance_std": "1",
    "second_reflectance": "1",
    "second_reflectance_std": "1",
    "background": "count",
    "photons": "count",
    "resolution": "pixel",
    "fit_chi_square": "1",
    "fit_p_value": "1",
}
LONG_NAMES = {
    "depth": "distance from the camera along the optical axis",
    "depth_std": "standard deviation of depth",
    "other_depth": "depth of a second lag that is nearly as likely, of pixels so flagged",
    "second_depth": "depth of the farther surface of pixels that see two",
    "second_depth_std": "standard deviation of second_depth",
    "near_reflectance": "reflectance of the nearer surface alone of pixels that see two",
    "near_reflectance_std": "standard deviation of near_reflectance",
    "second_reflectance": "reflectance of the farther surface of pixels that see two",
    "second_reflectance_std": "standard deviation of second_reflectance",
    "near_share": "share of a mixed pixel that the near surface covers",
    "near_share_std": "standard deviation of near_share",
    "reflectance_std": "standard deviation of reflectance",
    "background": "counts per code that the pulses do not explain",
    "photons": "photons in the pixel's histogram",
    "resolution": "width of the square of as many pixels as the estimate rests on",
    "fit_chi_square": "Pearson's chi-square of the fit per degree of freedom",
    "fit_p_value": "probability that a pixel with one surface fits as badly",
}

#: the attribute `exposures` of an image
EXPOSURES_KNOWN = "known"
EXPOSURES_ASSUMED = "unknown: taken to be as many as those of the reference; state frames"
EXPOSURES_UNKNOWN = (
    "unknown for the reference: reflectance is as if both had as many, and the reference is not "
    "corrected for pile-up; state frames when calibrating and when reconstructing"
)


def as_image(
    estimates: Estimates,
    calibration: Calibration,
    *,
    method: str,
    range_correction: bool,
    exposures_known: bool,
) -> xr.Dataset:
    """Return estimates as a labeled image.

    Parameters
    ----------
    estimates : Estimates
        What a method found.
    calibration : Calibration
        Calibration that it used.
    method : str
        Name of the method.
    range_correction : bool
        Whether the reflectances were corrected for the distance.
    exposures_known : bool
        Whether the number of exposures behind the counts is known, not assumed.

    Returns
    -------
    Dataset
        Dimensions (row, col) and (row, col, band); units and provenance in the attributes.
    """
    found = _arrays(estimates)
    shapes = tuple((name, values.shape, values.dtype) for name, values in found.items())
    kept = _labels.setdefault(calibration, {})
    key = method, range_correction, exposures_known, shapes
    if key not in kept:
        empty = {
            name: np.broadcast_to(values.dtype.type(0), values.shape)
            for name, values in found.items()
        }
        kept[key] = _labeled(empty, calibration, method, range_correction, exposures_known)
    return _with_values(kept[key], found)


def _labeled(
    found: dict[str, NDArray[Any]],
    calibration: Calibration,
    method: str,
    range_correction: bool,
    exposures_known: bool,
) -> xr.Dataset:
    """Return values by name as a labeled image."""
    plane, cube = ("row", "col"), ("row", "col", "band")
    variables = {}
    for name in (*UNITS, "quality"):
        if name in found:
            dims = cube if found[name].ndim == 3 else plane
            variables[name] = (dims, found[name], _attributes(name, range_correction))
    instrument = calibration.instrument
    exposures = EXPOSURES_KNOWN if exposures_known else EXPOSURES_ASSUMED
    if calibration.frames is None:
        exposures = EXPOSURES_UNKNOWN
    coordinates: dict[str, Any] = {
        "wavelength": (
            "band",
            instrument.wavelengths_nm,
            {"units": "nm", "long_name": "peak emission wavelength"},
        ),
        "band_name": ("band", [band.name for band in instrument.bands]),
        # the same as labels: image.sel(band="green")
        "band": [band.name for band in instrument.bands],
    }
    if "white_photons" in found:
        share = calibration.brightness / calibration.brightness.sum()
        coordinates["white_photons"] = (
            plane,
            found["white_photons"],
            {"units": "count", "long_name": "photons of reflectance 1 in all bands"},
        )
        coordinates["white_share"] = (
            "band",
            share,
            {"units": "1", "long_name": "share of a band in white_photons"},
        )
    return xr.Dataset(
        variables,
        coords=coordinates,
        attrs={
            "method": method,
            "instrument": instrument.name,
            "instrument_fingerprint": calibration.instrument_fingerprint,
            "reference_distance_m": calibration.distance,
            "exposures": exposures,
            "software": _software(),
        },
    )


def like_image(image: xr.Dataset, estimates: Estimates) -> xr.Dataset:
    """Return other estimates labeled as those of an image; much faster than `as_image`.

    Parameters
    ----------
    image : Dataset
        Image of the same instrument, calibration and method, from `as_image`.
    estimates : Estimates
        What the method found this time, of the same quantities.

    Returns
    -------
    Dataset
        Image as `as_image` gives it.
    """
    return _with_values(image, _arrays(estimates))


def _with_values(image: xr.Dataset, found: dict[str, NDArray[Any]]) -> xr.Dataset:
    """Return an image with other values, by name."""
    new = image.copy(data={name: found[str(name)] for name in image.data_vars})
    variables = new.variables
    for name in image.coords.keys() - image.indexes.keys():  # which copying leaves as they are
        variable = variables[name]
        variable.data = found[str(name)] if name in found else variable.values.copy()
    return new


def _arrays(estimates: Estimates) -> dict[str, NDArray[Any]]:
    """Values of an image by name, shapes (row, col) and (row, col, band)."""
    found: dict[str, NDArray[Any]] = {"quality": estimates.quality}
    for name in (*UNITS, "white_photons"):
        values = getattr(estimates, name)
        if values is not None:
            ordered = np.moveaxis(values, 0, -1) if values.ndim == 3 else values
            found[name] = ordered.astype(np.float32, copy=False)
    return found


def _attributes(name: str, range_correction: bool) -> dict[str, Any]:
    """Attributes of a variable."""
    if name == "quality":
        return {"long_name": "quality flags", **flag_attributes()}
    attributes: dict[str, Any] = {"units": UNITS[name]}
    if name.endswith("reflectance"):
        attributes |= correction_attributes(range_correction)
    if name != "reflectance":
        attributes["long_name"] = LONG_NAMES[name]
    return attributes


@cache
def _software() -> str:
    """Return name and version; cached, because looking them up searches the disk."""
    return f"hueflight {version('hueflight')}"
