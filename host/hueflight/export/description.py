# SPDX-License-Identifier: Apache-2.0
"""Metadata of every exported file: units, wavelengths, calibration and software."""

from __future__ import annotations

import hashlib
import json
import unicodedata
from itertools import chain
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import ExportError
from hueflight.files.bands import band_names
from hueflight.files.image_schema import require_image

CONVENTIONS = "CF-1.11"  #: attributes follow the Climate and Forecast metadata conventions


def describe(image: xr.Dataset, calibration: Calibration, /, **more: str) -> xr.Dataset:
    """Add the metadata that readers of the exported file need to an image.

    Parameters
    ----------
    image : xarray.Dataset
        Image that `reconstruct` made with this calibration.
    calibration : Calibration
        Calibration that the image was made with.
    **more : str
        Further attributes, such as the name of the recording.

    Returns
    -------
    xarray.Dataset
        A copy of the image. Its attributes hold the instrument and the origin of the calibration as
        JSON, and the coordinate `emission_fwhm` holds the spectral widths of the bands in nm,
        NaN where the instrument does not state them.

    Raises
    ------
    ImageError
        If it is not an image.
    ExportError
        If the image comes from another instrument than the calibration.
    """
    require_image(image)
    instrument = calibration.instrument
    fingerprint = image.attrs.get("instrument_fingerprint", instrument.fingerprint())
    if fingerprint != instrument.fingerprint():
        raise ExportError(
            f"the image comes from instrument {image.attrs.get('instrument')!r} ({fingerprint}), "
            f"the calibration from {instrument.name!r} ({instrument.fingerprint()}): use the "
            "calibration that the image was made with"
        )
    # of a band whose width is not stated, none is invented
    widths = [
        np.nan if band.emission_fwhm_nm is None else band.emission_fwhm_nm
        for band in instrument.bands
    ]
    if "band_name" in image.coords:  # some of the bands may have been selected, in any order
        numbers = {band.name: number for number, band in enumerate(instrument.bands)}
        widths = [widths[numbers[str(name)]] for name in image["band_name"].values]
    described = image.assign_coords(
        emission_fwhm=(
            "band",
            np.asarray(widths, dtype=np.float64),
            {"units": "nm", "long_name": "full width at half maximum of the emission"},
        )
    )
    described.attrs |= {
        "instrument_description": instrument.to_json(),
        "calibration": json.dumps(calibration_origin(calibration), sort_keys=True),
        **more,
    }
    return with_conventions(described)


def calibration_origin(calibration: Calibration) -> dict[str, Any]:
    """Return the origin of a calibration as plain values, with a digest of its content."""
    digest = hashlib.sha256()
    for array in chain(
        calibration.reference_blocks(),
        [
            calibration.bins.edges_ns,
            calibration.pixel_delay_ns,
            calibration.brightness,
            calibration.flat_field,
            calibration.usable,
        ],
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    return {
        **json.loads(json.dumps(calibration.provenance, default=str)),
        "distance_m": calibration.distance,
        "digest": digest.hexdigest()[:16],
    }


def with_conventions(image: xr.Dataset) -> xr.Dataset:
    """Return a copy whose attributes follow the CF conventions."""
    polished = image.copy()
    polished.attrs = {
        "Conventions": CONVENTIONS,
        "title": "Multispectral time-of-flight image",
        **image.attrs,
    }
    polished["wavelength"].attrs.setdefault("standard_name", "radiation_wavelength")
    for name in polished.data_vars:
        variable = polished[name]
        companions = [
            other for other in (f"{name}_std", "quality") if other in polished and other != name
        ]
        if companions and not str(name).endswith("_std"):
            variable.attrs["ancillary_variables"] = " ".join(companions)
        if "flag_masks" in variable.attrs:  # CF 3.5: of the same type as the flags
            masks = np.asarray(variable.attrs["flag_masks"], dtype=variable.dtype)
            variable.attrs["flag_masks"] = masks
    return polished


def band_widths_nm(image: xr.Dataset) -> NDArray[np.float64] | None:
    """Return the spectral widths (band,) at half maximum in nm, NaN for a band without one.

    None if the image states no width at all.
    """
    if "emission_fwhm" not in image.coords:
        return None
    widths = np.asarray(image["emission_fwhm"].values, dtype=np.float64)
    return widths if np.isfinite(widths).any() else None


def band_labels(image: xr.Dataset) -> list[str]:
    """Return a short, unique name for each band that any format can hold, such as ``659nm``."""
    wavelengths = image["wavelength"].values
    for digits in range(4):
        labels = [f"{value:.{digits}f}nm".replace(".", "_") for value in wavelengths]
        if len(set(labels)) == len(labels):
            return labels
    return [f"{value:.0f}nm_{band}" for band, value in enumerate(wavelengths)]


def plain_attributes(image: xr.Dataset) -> dict[str, str]:
    """Return the metadata of an image as flat text, for formats that hold nothing else."""
    flat: dict[str, str] = {}
    for key, value in image.attrs.items():
        if key == "instrument_description":  # long; only formats with JSON hold it
            continue
        if key == "calibration":
            for inner, entry in json.loads(value).items():
                flat[f"calibration.{inner}"] = (
                    ", ".join(f"{v}" for v in entry) if isinstance(entry, list) else str(entry)
                )
        else:
            flat[str(key)] = str(value)
    flat["bands"] = "; ".join(
        f"{name} {wavelength:g} nm"
        for name, wavelength in zip(band_names(image), image["wavelength"].values, strict=True)
    )
    correction = image["reflectance"].attrs.get("range_correction")
    if correction is not None:
        flat["reflectance.range_correction"] = str(correction)
    flat["units"] = "; ".join(
        f"{name} [{variable.attrs.get('units', '1')}]" for name, variable in image.data_vars.items()
    )
    return flat


def ascii_text(text: str) -> str:
    r"""Return text for formats that hold only ASCII: ``Caméra`` becomes ``Camera``.

    Characters without such an equivalent are written as escapes, such as ``\u03bb``.
    """
    decomposed = unicodedata.normalize("NFKD", text)
    plain = "".join(c for c in decomposed if not unicodedata.combining(c))
    return plain.encode("ascii", "backslashreplace").decode()
