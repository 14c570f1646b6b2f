# SPDX-License-Identifier: Apache-2.0
"""Spectral indices: normalized differences of two bands, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from hueflight.errors import ImageError
from hueflight.files.bands import NEAR_NM, band_names, find_band
from hueflight.files.image_schema import instrument_of
from hueflight.model.instrument import Instrument

#: standard deviations by which a sum must exceed 0, so that its inverse is nearly linear
RESOLVED_SIGMA = 10.0


@dataclass(frozen=True)
class SpectralIndex:
    """A published normalized difference (first − second) / (first + second) of two bands.

    Attributes
    ----------
    name : str
        Its usual name.
    first_nm, second_nm : tuple of float
        Lowest and highest center wavelength of either band, nm.
    max_fwhm_nm : float
        Largest width of a band at half maximum, nm.
    source : str
        Publication.
    """

    name: str
    first_nm: tuple[float, float]
    second_nm: tuple[float, float]
    max_fwhm_nm: float
    source: str


INDICES = {
    index.name: index
    for index in (
        SpectralIndex("NDVI", (760, 900), (620, 700), 150, "Rouse et al., NASA SP-351, 309, 1974"),
        SpectralIndex(
            "NGRDI", (510, 580), (620, 700), 100, "Tucker, Remote Sens. Environ. 8, 127, 1979"
        ),
        SpectralIndex(
            "PRI", (528, 534), (567, 573), 10, "Gamon et al., Remote Sens. Environ. 41, 35, 1992"
        ),
    )
}


def normalized_difference(
    image: xr.Dataset,
    first: str | int,
    second: str | int,
    /,
    *,
    within_nm: float = NEAR_NM,
) -> xr.Dataset:
    """Compute (first − second) / (first + second) of two bands, with its standard deviation.

    Parameters
    ----------
    image : xarray.Dataset
        Image or spectra of regions, with `reflectance` and `reflectance_std`.
    first, second : str or int
        Bands by name, number or wavelength, such as ``"532 nm"``.
    within_nm : float
        Largest distance of a band from a wavelength, in nm.

    Returns
    -------
    xarray.Dataset
        `index` and `index_std`, by propagation to first order, in which deviations of different
        bands count as independent. Both are NaN where the sum of the bands is less than ten of
        its standard deviations: there the propagation does not hold.

    Raises
    ------
    ImageError
        If there is no such band.
    """
    cube, deviations = image["reflectance"], image["reflectance_std"]
    where = [find_band(image, band, within_nm=within_nm) for band in (first, second)]
    a, b = (cube.isel(band=band, drop=True).astype(np.float64) for band in where)
    a_std, b_std = (deviations.isel(band=band, drop=True).astype(np.float64) for band in where)
    total = a + b
    resolved = total > RESOLVED_SIGMA * np.hypot(a_std, b_std)
    total = total.where(resolved)
    names = [band_names(image)[band] for band in where]
    text = f"({names[0]} - {names[1]}) / ({names[0]} + {names[1]})"
    return xr.Dataset(
        {
            "index": ((a - b) / total).assign_attrs(units="1", long_name=text),
            "index_std": (2 * ((b * a_std) ** 2 + (a * b_std) ** 2) ** 0.5 / total**2).assign_attrs(
                units="1", long_name="standard deviation of index"
            ),
        }
    )


def spectral_index(
    image: xr.Dataset, name: str, /, *, instrument: Instrument | None = None
) -> xr.Dataset:
    """Compute a published index, if the bands of the instrument support it.

    Parameters
    ----------
    image : xarray.Dataset
        Image with `reflectance` and `reflectance_std`.
    name : str
        One of `INDICES`.
    instrument : Instrument, optional
        Instrument, whose bands have center and width; by default the one that the image describes.

    Returns
    -------
    xarray.Dataset
        `index` and `index_std`; see `normalized_difference`.

    Raises
    ------
    ImageError
        If the index is unknown, or a band that it needs does not exist or is too wide; the message
        says which.
    """
    if name not in INDICES:
        raise ImageError(f"index {name!r}: choose one of {', '.join(INDICES)}")
    index, source = INDICES[name], instrument_of(image, instrument)
    if len(source.bands) != image.sizes["band"]:
        raise ImageError(
            f"the image has {image.sizes['band']} bands, instrument {source.name!r} has "
            f"{len(source.bands)}"
        )
    bands = [_supporting(index, window, source) for window in (index.first_nm, index.second_nm)]
    found = normalized_difference(image, bands[0], bands[1])
    found["index"].attrs["standard_index"] = f"{name}: {index.source}"
    return found


def _supporting(index: SpectralIndex, window: tuple[float, float], instrument: Instrument) -> int:
    """Number of the band nearest to the middle of a window, if it lies in it and is narrow."""
    middle = sum(window) / 2
    away = np.abs(instrument.wavelengths_nm - middle)
    number = int(away.argmin())
    band, width = instrument.bands[number], instrument.bands[number].spectral_fwhm_nm
    if not window[0] <= band.wavelength_nm <= window[1]:
        raise ImageError(
            f"index {index.name} needs a band between {window[0]:g} and {window[1]:g} nm; the "
            f"nearest of instrument {instrument.name!r} is {band.name!r} at "
            f"{band.wavelength_nm:g} nm"
        )
    if width > index.max_fwhm_nm:
        raise ImageError(
            f"index {index.name} needs a band at most {index.max_fwhm_nm:g} nm wide between "
            f"{window[0]:g} and {window[1]:g} nm; {band.name!r} is {width:g} nm wide"
        )
    return number
