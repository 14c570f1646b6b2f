# SPDX-License-Identifier: Apache-2.0
"""Build the image: estimates labeled with dimensions, wavelengths and units."""

from __future__ import annotations

from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr

from hueflight.calibration import Calibration
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.quality import flag_attributes
from hueflight.reconstruction.range_correction import attributes as correction_attributes

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


def as_image(
    estimates: Estimates, calibration: Calibration, *, method: str, range_correction: bool
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

    Returns
    -------
    Dataset
        Dimensions (row, col) and (row, col, band); units and provenance in the attributes.
    """
    plane, cube = ("row", "col"), ("row", "col", "band")
    variables = {}
    for name, unit in UNITS.items():
        values = getattr(estimates, name)
        if values is None:
            continue
        dims = cube if values.ndim == 3 else plane
        ordered = np.moveaxis(values, 0, -1) if values.ndim == 3 else values
        attributes = {"units": unit}
        if name.endswith("reflectance"):
            attributes |= correction_attributes(range_correction)
        if name != "reflectance":
            attributes["long_name"] = LONG_NAMES[name]
        variables[name] = (dims, ordered.astype(np.float32), attributes)
    variables["quality"] = (
        plane,
        estimates.quality,
        {"long_name": "quality flags", **flag_attributes()},
    )
    instrument = calibration.instrument
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
    if estimates.white_photons is not None:
        share = calibration.brightness / calibration.brightness.sum()
        coordinates["white_photons"] = (
            plane,
            estimates.white_photons.astype(np.float32),
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
            "instrument_fingerprint": instrument.fingerprint(),
            "reference_distance_m": calibration.distance,
            "software": _software(),
        },
    )


@cache
def _software() -> str:
    """Return name and version; cached, because looking them up searches the disk."""
    return f"hueflight {version('hueflight')}"
