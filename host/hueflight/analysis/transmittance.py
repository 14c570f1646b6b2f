# SPDX-License-Identifier: Apache-2.0
"""Transmittance: the same instrument with a sample in the path of its light.

The reference is the light without the sample. What `reconstruct` then calls reflectance is the
share of the light that the sample transmits, and its delay is that of a longer optical path.
The paper mentions this use in its introduction.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from hueflight.errors import HueflightError
from hueflight.files.image_schema import instrument_of, require_image
from hueflight.model.instrument import Instrument
from hueflight.reconstruction.range_correction import range_correction_of


def transmittance(image: xr.Dataset, /, *, instrument: Instrument | None = None) -> xr.Dataset:
    """Compute the transmittance and absorbance of a sample in every band.

    Parameters
    ----------
    image : Dataset
        Image reconstructed from a capture through the sample, with a calibration whose reference is
        the light without it; both with the same setup. Reconstruct it with
        ``range_correction=False``.
    instrument : Instrument or None
        Instrument whose lens gives the directions of the rays; None to read it from the image.

    Returns
    -------
    Dataset
        `transmittance` (1) and `absorbance` (−log₁₀ of it), `optical_path` (m), each with its
        standard deviation in a variable ending in `_std`, and `quality`. Absorbance is NaN where no
        light was transmitted. The optical path is the additional one caused by the sample; for
        light that passes once through a plate of refractive index n and thickness d it is (n − 1)
        d.

    Raises
    ------
    HueflightError
        If the image was reconstructed with range correction, which would take the delay for a
        distance, or does not say its reference distance.
    """
    require_image(image)
    if range_correction_of(image) not in (None, "none"):
        raise HueflightError(
            "the image was reconstructed with range correction, but the delay in a sample is no "
            "distance: reconstruct it with range_correction=False (--no-range-correction)"
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
