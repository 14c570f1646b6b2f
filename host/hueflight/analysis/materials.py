# SPDX-License-Identifier: Apache-2.0
"""Materials as further planes of an image, which every format, viewer and client takes."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import xarray as xr

from hueflight.analysis.indices import INDICES, normalized_difference, spectral_index
from hueflight.analysis.library import SpectralLibrary
from hueflight.analysis.unmixing import unmix
from hueflight.errors import HueflightError, ImageError
from hueflight.files.image_schema import instrument_of
from hueflight.model.instrument import Instrument

ABUNDANCE, INDEX = "abundance_", "index_"  #: what the names of the planes begin with
CHI_SQUARE = "unmixing_chi_square"


def add_materials(
    image: xr.Dataset,
    /,
    *,
    library: SpectralLibrary | None = None,
    indices: Sequence[str] = (),
    instrument: Instrument | None = None,
) -> xr.Dataset:
    """Add abundances of materials and spectral indices to an image, with standard deviations.

    Parameters
    ----------
    image : xarray.Dataset
        Image, live picture or series with `reflectance` and `reflectance_std`.
    library : SpectralLibrary, optional
        Materials to look for; see `unmix`.
    indices : sequence of str
        Names of `INDICES`, or two bands with a comma between them, such as ``"525 nm, 659 nm"``,
        for their normalized difference.
    instrument : Instrument, optional
        Instrument that made the image; by default the one that the image describes.

    Returns
    -------
    xarray.Dataset
        The image with the planes ``abundance_NAME``, ``abundance_NAME_std`` for each entry of the
        library, ``unmixing_chi_square``, and ``index_NAME``, ``index_NAME_std`` for each index.
        Characters of a name other than letters and digits become ``_``.

    Raises
    ------
    ImageError
        If the bands do not support an index, or two planes would have the same name.
    HueflightError
        If the bands do not tell the materials apart.
    """
    planes: dict[str, xr.DataArray] = {}
    if library is not None:
        _add(planes, _abundances(image, library, instrument_of(image, instrument)))
    for index in indices:
        _add(planes, _index(image, index, instrument))
    return image.assign(planes)


def _add(planes: dict[str, xr.DataArray], more: dict[str, xr.DataArray]) -> None:
    for name, plane in more.items():
        if name in planes:
            raise ImageError(f"two planes would be called {name!r}: rename or leave out one")
        planes[name] = plane.astype(np.float32)


def _abundances(
    image: xr.Dataset, library: SpectralLibrary, instrument: Instrument
) -> dict[str, xr.DataArray]:
    found = unmix(image["reflectance"], image["reflectance_std"], library, instrument)
    planes: dict[str, xr.DataArray] = {}
    for number, entry in enumerate(library.names):
        name = ABUNDANCE + plain(entry)
        one = found.isel(entry=number).drop_vars("entry")
        text = f"abundance of {entry}"
        _add(planes, {name: one["abundance"].assign_attrs(units="1", long_name=text)})
        text = f"standard deviation of {name}"
        planes[f"{name}_std"] = one["abundance_std"].assign_attrs(units="1", long_name=text)
    text = "chi-square of the unmixing per degree of freedom"
    planes[CHI_SQUARE] = found["fit_chi_square"].assign_attrs(units="1", long_name=text)
    return planes


def _index(image: xr.Dataset, index: str, instrument: Instrument | None) -> dict[str, xr.DataArray]:
    first, comma, second = index.partition(",")
    if index not in INDICES and not comma:
        raise ImageError(
            f"index {index!r}: choose one of {', '.join(INDICES)}, or name two bands such as "
            "'525 nm, 659 nm'"
        )
    if comma:
        found = normalized_difference(image, first.strip(), second.strip())
    else:
        found = spectral_index(image, index, instrument=instrument)
    name = INDEX + "_".join(plain(part) for part in index.split(","))
    return {name: found["index"], f"{name}_std": found["index_std"]}


def plain(name: str) -> str:
    """Return a name with letters, digits and ``_`` alone, which any format can hold."""
    short = re.sub(r"(?<=\d)\s+nm\b", "nm", name.strip())
    text = re.sub(r"[^0-9A-Za-z]+", "_", short).strip("_")
    if not text:
        raise HueflightError(f"name {name!r}: must have a letter or a digit of ASCII")
    return text
