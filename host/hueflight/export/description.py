"""What every exported file says of itself: units, wavelengths, calibration, software."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import ExportError
from hueflight.files.image_schema import require_image

CONVENTIONS = "CF-1.11"  #: attributes follow the Climate and Forecast metadata conventions


def describe(image: xr.Dataset, calibration: Calibration, /, **more: str) -> xr.Dataset:
    """The image with all that a reader elsewhere needs: instrument, calibration, band widths.

    Parameters
    ----------
    image : as `reconstruct` gives with this calibration.
    calibration : that it was made with.
    more : further attributes, such as the name of the recording.

    Returns
    -------
    A copy with the instrument and the calibration's origin as JSON in `attrs`, and with the
    coordinate `emission_fwhm` (nm). Point clouds and header files are made from these.

    Raises
    ------
    ExportError
        If it is not an image, or one of another instrument.
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
    widths = [band.emission_fwhm_nm for band in instrument.bands]
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
    """Where a calibration came from, as plain values, with a digest of what it holds."""
    digest = hashlib.sha256()
    for array in (
        calibration.reference,
        calibration.bins.edges_ns,
        calibration.pixel_delay_ns,
        calibration.brightness,
        calibration.flat_field,
        calibration.usable,
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    return {
        **json.loads(json.dumps(calibration.provenance, default=str)),
        "distance_m": calibration.distance,
        "digest": digest.hexdigest()[:16],
    }


def with_conventions(image: xr.Dataset) -> xr.Dataset:
    """A copy whose attributes follow the CF conventions."""
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


def band_names(image: xr.Dataset) -> list[str]:
    """Name of each band; its wavelength where it has none."""
    if "band_name" in image.coords:
        return [str(name) for name in image["band_name"].values]
    return [f"{wavelength:g} nm" for wavelength in image["wavelength"].values]


def band_widths_nm(image: xr.Dataset) -> NDArray[np.float64] | None:
    """Spectral width (band,) at half maximum, nm, if the image knows."""
    if "emission_fwhm" not in image.coords:
        return None
    return np.asarray(image["emission_fwhm"].values, dtype=np.float64)


def band_labels(image: xr.Dataset) -> list[str]:
    """A short name for each band that fits any format: ``659nm``, unique."""
    wavelengths = image["wavelength"].values
    for digits in range(4):
        labels = [f"{value:.{digits}f}nm".replace(".", "_") for value in wavelengths]
        if len(set(labels)) == len(labels):
            return labels
    return [f"{value:.0f}nm_{band}" for band, value in enumerate(wavelengths)]


def plain_attributes(image: xr.Dataset) -> dict[str, str]:
    """Everything known of an image as flat text, for formats that hold only that."""
    flat: dict[str, str] = {}
    for key, value in image.attrs.items():
        if key == "instrument_description":  # long; kept by the formats that hold JSON
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
    flat["units"] = "; ".join(
        f"{name} [{variable.attrs.get('units', '1')}]" for name, variable in image.data_vars.items()
    )
    return flat
