# SPDX-License-Identifier: Apache-2.0
"""Multi-page TIFF: every plane of an image is a page with its description."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ExportError
from hueflight.export.description import band_widths_nm, plain_attributes
from hueflight.files import import_optional, staged
from hueflight.files.bands import band_names, find_band
from hueflight.files.image_schema import SERIES_DIM, captures, layers, require_image

DESCRIPTION_TAG, PAGE_NAME_TAG = 270, 285
#: places for name and description in every page of a run, which `_name_pages` fills; no longer than
#: one character, as pages that tifffile writes in one go share all values outside of the tags
PLACES = [(tag, "s", 0, " ", False) for tag in (DESCRIPTION_TAG, PAGE_NAME_TAG)]
CLASSIC_LIMIT = 2**32 - 2**25  #: bytes that a classic TIFF can address, minus room for its tags

Page = tuple[NDArray[Any], str, dict[str, Any]]  #: values, name and description
Tag = tuple[int, Any, int, Any, bool]  #: as tifffile takes them


def write_tiff(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    variable: str | None = None,
    band: str | int | None = None,
    overwrite: bool = False,
) -> None:
    """Write an image or series as a multi-page TIFF.

    There is one page for each variable, or for each of its bands, as float32; quality flags are
    uint16. Each page has a readable name (tag 285) and a description as JSON with variable,
    capture, band, wavelength, spectral width and units. The first page also holds the metadata of
    the image. Values of successive pages of one type follow each other in the file, as ImageJ asks
    of a stack; where all pages are of one type, their names are ImageJ's slice labels.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the file.
    variable : str, optional
        Variable to write, such as ``depth``; by default all of them.
    band : str or int, optional
        Name, number or wavelength (``"532 nm"``) of the band to write, for a variable with one
        plane per band; by default all of them.
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
    wanted = None if band is None else find_band(image, band)
    pages = list(_pages(image, variable, wanted))
    if not pages:
        known = ", ".join(map(str, image.data_vars))
        raise ExportError(
            f"variable = {variable!r}, band = {band!r}: there is no such plane; the image has "
            f"{known}, and {image.sizes['band']} bands from 0"
        )
    runs = [list(run) for _, run in groupby(pages, key=lambda page: page[0].dtype)]
    big = sum(plane.nbytes for plane, _, _ in pages) > CLASSIC_LIMIT
    with staged(path, overwrite=overwrite) as partial:
        with tifffile.TiffWriter(partial, bigtiff=big, byteorder="<") as writer:
            for run in runs:
                planes = [plane for plane, _, _ in run]
                writer.write(
                    iter(planes),
                    shape=(len(planes), *planes[0].shape),
                    dtype=planes[0].dtype,
                    photometric="minisblack",
                    metadata=None,  # otherwise tifffile writes a description of its own
                    software=image.attrs.get("software", "hueflight"),
                    extratags=[*PLACES, *(_slice_labels(run) if len(runs) == 1 else ())],
                )
        _name_pages(partial, pages)


def storable(plane: NDArray[Any], name: str) -> NDArray[Any]:
    """Return the plane in a type that TIFF readers support."""
    if plane.dtype.kind == "b":
        return plane.astype(np.uint8)
    if plane.dtype.name not in ("uint8", "uint16", "uint32", "int16", "int32", "float32"):
        if plane.dtype.kind == "f":
            return plane.astype(np.float32)
        raise ExportError(f"TIFF readers don't know {plane.dtype} of {name!r}: convert it first")
    return plane


def _slice_labels(run: list[Page]) -> tuple[Tag, ...]:
    """Tags of the first page that hold the names of all pages as ImageJ's slice labels."""
    tifffile = import_optional("tifffile", extra="export")
    return tifffile.imagej_metadata_tag({"Labels": [name for _, name, _ in run]}, "<")


def _name_pages(path: Path, pages: list[Page]) -> None:
    """Give each page of a file that was written its own name and description."""
    tifffile = import_optional("tifffile", extra="export")
    with tifffile.TiffFile(path, mode="r+") as file:
        for page, (_, name, about) in zip(file.pages, pages, strict=True):
            page.tags[PAGE_NAME_TAG].overwrite(_ascii(name))
            page.tags[DESCRIPTION_TAG].overwrite(json.dumps(about))


def _pages(image: xr.Dataset, wanted: str | None, wanted_band: int | None) -> Iterator[Page]:
    names, wavelengths = band_names(image), image["wavelength"].values
    widths = band_widths_nm(image)
    first: dict[str, Any] = {"image": plain_attributes(image)}
    for number, single in enumerate(captures(image)):
        for variable, band, plane in layers(single):
            if wanted not in (None, variable) or wanted_band not in (None, band):
                continue
            attributes = single[variable].attrs
            about = {"variable": variable, "capture": number, **first}
            # the captures of a series have names; a single image has none
            title = (
                f"{variable} {single[SERIES_DIM].item()}"
                if SERIES_DIM in single.coords
                else variable
            )
            about["units"] = attributes.get("units", "1")
            if "flag_meanings" in attributes:
                about["flag_meanings"] = attributes["flag_meanings"]
                about["flag_masks"] = [int(mask) for mask in attributes["flag_masks"]]
            if band is not None:
                title += f" {names[band]} {wavelengths[band]:g} nm"
                about |= {"band": names[band], "wavelength_nm": float(wavelengths[band])}
                if widths is not None and np.isfinite(widths[band]):
                    about["fwhm_nm"] = float(widths[band])
            yield storable(plane, variable), title, about
            first = {}


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()
