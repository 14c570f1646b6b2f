"""Transmittance: the same instrument looking through a sample instead of at one.

The reference is the light without the sample. What `reconstruct` then calls reflectance is the
share of the light that the sample lets through, and its delay is that of a longer optical path.
The paper names this use in its introduction.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from hueflight.errors import HueflightError
from hueflight.files.image_schema import instrument_of, require_image
from hueflight.model.instrument import Instrument


def transmittance(image: xr.Dataset, /, *, instrument: Instrument | None = None) -> xr.Dataset:
    """Transmittance and absorbance of a sample in every band.

    Parameters
    ----------
    image : reconstructed from a capture through the sample, with a calibration whose
        reference is the light without it, both set up alike.
    instrument : whose lens gives the directions; by default as the image describes.

    Returns
    -------
    Dataset with `transmittance` (1) and `absorbance` (−log₁₀ of it), each with `_std`, and
    `optical_path` with `_std`: how much longer the light's path is than without the sample,
    m; for light that passes once through a slab of index n and thickness d it is (n − 1) d.
    Absorbance is NaN where no light came through. Neither holds for a reconstruction with
    `range_correction`, which would take the delay for a distance.

    Raises
    ------
    HueflightError
        If the image was made with range correction, or does not say its reference distance.
    """
    require_image(image)
    if image.attrs.get("range_correction"):
        raise HueflightError(
            "the image was reconstructed with range_correction: a sample's delay is no distance; "
            "reconstruct again without it"
        )
    if "reference_distance_m" not in image.attrs:
        raise HueflightError("the image does not say its reference_distance_m")
    share, share_std = image["reflectance"], image["reflectance_std"]
    positive = share > 0
    absorbance = -xr.apply_ufunc(np.log10, share.where(positive))
    # a depth z took light 2 z / cos to travel, out and back along the pixel's ray
    cosine = xr.DataArray(instrument_of(image, instrument).ray_cosine(), dims=("row", "col"))
    path = 2 * (image["depth"] - image.attrs["reference_distance_m"]) / cosine
    found = {
        "transmittance": share.assign_attrs(units="1"),
        "transmittance_std": share_std.assign_attrs(units="1"),
        "absorbance": absorbance.assign_attrs(units="1", long_name="decadic absorbance"),
        "absorbance_std": (share_std / (share.where(positive) * np.log(10))).assign_attrs(
            units="1"
        ),
        "optical_path": path.assign_attrs(units="m", long_name="additional optical path"),
        "optical_path_std": (2 * image["depth_std"] / cosine).assign_attrs(units="m"),
        "quality": image["quality"],
    }
    return xr.Dataset(found, attrs={**image.attrs, "title": "Transmittance"})
