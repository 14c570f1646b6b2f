# SPDX-License-Identifier: Apache-2.0
"""Multi-page TIFF: every plane of an image is a page with its description."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ExportError
from hueflight.export.description import band_widths_nm, plain_attributes
from hueflight.files import import_optional, staged
from hueflight.files.bands import band_names
from hueflight.files.image_schema import captures, layers, require_image

PAGE_NAME_TAG = 285
CLASSIC_LIMIT = 2**32 - 2**25  #: bytes that a classic TIFF can address, minus room for its tags


def write_tiff(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    variable: str | None = None,
    band: int | None = None,
    overwrite: bool = False,
) -> None:
    """Write an image or series as a multi-page TIFF.

    There is one page for each variable, or for each of its bands, as float32; quality flags are
    uint16. Each page has a readable name (tag 285) and a description as JSON with variable,
    capture, band, wavelength, spectral width and units. The first page also holds the metadata of
    the image.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the file.
    variable : str, optional
        Variable to write, such as ``depth``; by default all of them.
    band : int, optional
        Index of the band to write, for a variable with one plane per band; by default all of them.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    ImageError
        If it is not an image.
    ExportError
        If the format can't hold the image.
    OutputError
        If the file exists already or can't be written.
    """
    require_image(image)
    tifffile = import_optional("tifffile", extra="export")
    pages = list(_pages(image, variable, band))
    if not pages:
        known = ", ".join(map(str, image.data_vars))
        raise ExportError(
            f"variable = {variable!r}, band = {band!r}: there is no such plane; the image has "
            f"{known}, and {image.sizes['band']} bands from 0"
        )
    big = sum(plane.nbytes for plane, _, _ in pages) > CLASSIC_LIMIT
    with (
        staged(path, overwrite=overwrite) as partial,
        tifffile.TiffWriter(partial, bigtiff=big, byteorder="<") as writer,
    ):
        for plane, name, about in pages:
            writer.write(
                plane,
                photometric="minisblack",
                metadata=None,  # otherwise tifffile writes a description of its own
                description=json.dumps(about),
                software=image.attrs.get("software", "hueflight"),
                extratags=[(PAGE_NAME_TAG, "s", 0, _ascii(name), True)],
            )


def storable(plane: NDArray[Any], name: str) -> NDArray[Any]:
    """Return the plane in a type that TIFF readers support."""
    if plane.dtype.kind == "b":
        return plane.astype(np.uint8)
    if plane.dtype.name not in ("uint8", "uint16", "uint32", "int16", "int32", "float32"):
        if plane.dtype.kind == "f":
            return plane.astype(np.float32)
        raise ExportError(f"TIFF readers don't know {plane.dtype} of {name!r}: convert it first")
    return plane


def _pages(
    image: xr.Dataset, wanted: str | None, wanted_band: int | None
) -> Iterator[tuple[NDArray[Any], str, dict[str, Any]]]:
    names, wavelengths = band_names(image), image["wavelength"].values
    widths = band_widths_nm(image)
    first: dict[str, Any] = {"image": plain_attributes(image)}
    for number, single in enumerate(captures(image)):
        for variable, band, plane in layers(single):
            if wanted not in (None, variable) or wanted_band not in (None, band):
                continue
            attributes = single[variable].attrs
            about = {"variable": variable, "capture": number, **first}
            title = variable
            about["units"] = attributes.get("units", "1")
            if "flag_meanings" in attributes:
                about["flag_meanings"] = attributes["flag_meanings"]
                about["flag_masks"] = [int(mask) for mask in attributes["flag_masks"]]
            if band is not None:
                title = f"{variable} {names[band]} {wavelengths[band]:g} nm"
                about |= {"band": names[band], "wavelength_nm": float(wavelengths[band])}
                if widths is not None and np.isfinite(widths[band]):
                    about["fwhm_nm"] = float(widths[band])
            yield storable(plane, variable), title, about
            first = {}


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()
