# SPDX-License-Identifier: Apache-2.0
"""Images in colour: every visible band contributes to each sRGB value."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.arguments import NUMBER, takes
from hueflight.color.display import fill_missing, three_band_rgb
from hueflight.color.observer import encoded, linear_of
from hueflight.color.recovery import SpectralModel
from hueflight.errors import HueflightError
from hueflight.files.image_schema import instrument_of
from hueflight.model.emission import Emission
from hueflight.model.instrument import Instrument

VISIBLE_NM = (400.0, 700.0)
LEAST_BANDS = 3  #: fewer visible bands can't tell colours apart


def in_color(
    image: xr.Dataset,
    /,
    *,
    instrument: Instrument | None = None,
    emission: Emission | None = None,
) -> xr.DataArray:
    """Compute the tristimulus values of an image under illuminant D65.

    Parameters
    ----------
    image : Dataset
        Image or series as `hueflight.reconstruct` gives.
    instrument : Instrument or None
        Instrument whose bands the image holds; None to read it from the image.
    emission : Emission or None
        Measured spectra of its LEDs; None for those that the instrument states.

    Returns
    -------
    DataArray, dims (..., row, col, xyz)
        X, Y and Z as float32; reflectance 1 has Y = 1. NaN where no band is known.

    Raises
    ------
    HueflightError
        If the image does not name its instrument, or the emission is not that instrument's.
    """
    source = instrument_of(image, instrument)
    model = SpectralModel.of(source, emission).of_bands(_bands(image, source))
    reflectance = image["reflectance"].transpose(..., "band")
    deviation = image["reflectance_std"].transpose(..., "band")
    per_photon = None
    if "white_photons" in image.coords:
        white = image["white_photons"].transpose(*reflectance.dims[:-1]).values
        with np.errstate(divide="ignore", invalid="ignore"):
            photons = white[..., None] * image["white_share"].values
            per_photon = np.nan_to_num(1 / photons, posinf=0.0)
    xyz, _ = model.recover(
        reflectance.values, deviation.values, model.to_xyz(), per_photon=per_photon
    )
    return xr.DataArray(
        xyz.astype(np.float32), dims=(*reflectance.dims[:-1], "xyz"), coords={"xyz": list("XYZ")}
    )


@takes(image=xr.Dataset, instrument=Instrument, emission=Emission, white=NUMBER)
def color_picture(
    image: xr.Dataset,
    /,
    *,
    instrument: Instrument | None = None,
    emission: Emission | None = None,
    white: float | None = None,
) -> NDArray[np.float64]:
    """Render an image in colour from all bands, with small holes filled.

    An instrument with fewer than three visible bands has no colours: its picture shows three bands
    in false colours (`hueflight.color.display.three_band_rgb`).

    Parameters
    ----------
    image : Dataset
        Image as `hueflight.reconstruct` gives.
    instrument : Instrument or None
        Instrument whose bands the image holds; None to read it from the image.
    emission : Emission or None
        Measured spectra of its LEDs; None for those that the instrument states.
    white : float or None
        Reflectance shown as white; None so that 98 % of the pixels are in range.

    Returns
    -------
    ndarray of float, shape (row, col, 3)
        Display values sRGB in 0..1.

    Raises
    ------
    HueflightError
        If no pixel has a colour, or `white` is not above 0.
    """
    source = instrument_of(image, instrument)
    low, high = VISIBLE_NM
    seen_nm = source.wavelengths_nm[_bands(image, source)]
    if ((low <= seen_nm) & (seen_nm <= high)).sum() < LEAST_BANDS:
        return three_band_rgb(image)
    if white is not None and not (np.isfinite(white) and white > 0):
        raise HueflightError(f"white = {white!r}: give the reflectance to show as white, above 0")
    linear = linear_of(in_color(image, instrument=source, emission=emission).values)
    if not np.isfinite(linear).any():
        raise HueflightError("no pixel of the image has a reflectance: nothing to show")
    filled = np.stack([fill_missing(plane) for plane in np.moveaxis(linear, -1, 0)], axis=-1)
    top = white or max(float(np.nanpercentile(filled.max(axis=-1), 98)), 1e-12)
    return encoded(np.nan_to_num(filled / top))


def _bands(image: xr.Dataset, instrument: Instrument) -> list[int]:
    """Which of the instrument's bands the image holds."""
    names = [band.name for band in instrument.bands]
    if "band_name" not in image.coords:
        return list(range(len(names)))
    return [names.index(str(name)) for name in np.atleast_1d(image["band_name"].values)]
