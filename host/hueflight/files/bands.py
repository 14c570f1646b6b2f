# SPDX-License-Identifier: Apache-2.0
"""Bands of an image by name, by number or by wavelength."""

from __future__ import annotations

import re

import numpy as np
import xarray as xr

from hueflight.errors import ImageError

#: a wavelength finds the nearest band up to this distance, in nm, unless more is allowed
NEAR_NM = 10.0
_WAVELENGTH = re.compile(r"\s*(\d+(?:\.\d+)?)\s*nm\s*")


def band_names(image: xr.Dataset) -> list[str]:
    """Return the name of each band, or its wavelength if bands have no names."""
    if "band_name" in image.coords:
        return [str(name) for name in image["band_name"].values]
    return [f"{wavelength:g} nm" for wavelength in image["wavelength"].values]


def has_band_labels(image: xr.Dataset) -> bool:
    """Whether the names of the bands are labels for ``image.sel(band=...)`` too.

    They are in every image of an instrument; other images may have names that are not unique.
    """
    return "instrument_fingerprint" in image.attrs and "band_name" in image.coords


def find_band(image: xr.Dataset, band: str | int, /, *, within_nm: float = NEAR_NM) -> int:
    """Return the position of a band in an image.

    Parameters
    ----------
    image : xarray.Dataset
        Image, or any dataset with the coordinate `wavelength` of bands.
    band : str or int
        Name of the band, its number from 0, or a wavelength such as ``"532 nm"``, which stands for
        the nearest band.
    within_nm : float
        Largest distance of the nearest band from the wavelength, in nm.

    Returns
    -------
    int
        Position of the band, from 0.

    Raises
    ------
    ImageError
        If there is no such band; for a wavelength, the message says how far the nearest one is.

    Examples
    --------
    >>> image = xr.Dataset(coords={"wavelength": ("band", [445.0, 525.0])})
    >>> find_band(image, "532 nm")
    1
    """
    names, wavelengths_nm, text = band_names(image), image["wavelength"].values, str(band)
    if text in names:
        return names.index(text)
    if text.isdecimal() and int(text) < len(names):
        return int(text)
    found = _WAVELENGTH.fullmatch(text)
    if found is None:
        raise ImageError(
            f"there is no band {text!r}; choose from {', '.join(names)}, numbers 0 to "
            f"{len(names) - 1}, or wavelengths such as '532 nm'"
        )
    away = np.abs(wavelengths_nm - float(found[1]))
    nearest = int(away.argmin())
    if away[nearest] > within_nm:
        raise ImageError(
            f"band {text!r}: the nearest band is {names[nearest]!r} at "
            f"{wavelengths_nm[nearest]:g} nm, {away[nearest]:g} nm away, which is more "
            f"than {within_nm:g} nm"
        )
    return nearest
