# SPDX-License-Identifier: Apache-2.0
"""ENVI: a text header with a file of raw numbers, the usual format of imaging spectroscopy.

Keys follow the format's public description ("ENVI Header Files", L3Harris Geospatial
documentation): wavelengths with their units, full widths, and a list of bad bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ExportError
from hueflight.export.description import band_widths_nm, plain_attributes
from hueflight.files import staged
from hueflight.files.bands import band_names
from hueflight.files.image_schema import layers, require_image

TYPE_CODES = {"uint8": 1, "int16": 2, "int32": 3, "float32": 4, "float64": 5, "uint16": 12}


def write_envi(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    bad_bands: Sequence[bool] | None = None,
    overwrite: bool = False,
) -> None:
    """Write an image as ENVI cubes with wavelengths.

    `NAME.hdr` with `NAME.img` holds the reflectance. Every other quantity per band has a cube
    `NAME_quantity.hdr` with the same wavelengths. Quantities without bands (depth, quality, …) are
    the bands of `NAME_planes.hdr`.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    path : str or pathlib.Path
        Name of the header file, which ends in ``.hdr``.
    bad_bands : sequence of bool, optional
        True for each band that readers should ignore. By default these are the bands without any
        value and those whose median uncertainty exceeds their median reflectance.
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
    path = Path(path)
    if path.suffix.lower() != ".hdr":
        raise ExportError(f"{str(path)!r}: an ENVI header ends in .hdr")
    names, wavelengths = band_names(image), image["wavelength"].values
    widths = band_widths_nm(image)
    bad = find_bad_bands(image) if bad_bands is None else np.asarray(bad_bands, dtype=bool)
    if bad.shape != wavelengths.shape:
        raise ExportError(f"bad_bands has {bad.size} entries for {wavelengths.size} bands")
    spectral: dict[str, Any] = {
        "band names": names,
        "wavelength units": "Nanometers",
        "wavelength": [f"{value:g}" for value in wavelengths],
        "bbl": [str(int(not flag)) for flag in bad],  # 1 is a good band
    }
    if widths is not None and np.isfinite(widths).all():  # the format has no unknown entries
        spectral["fwhm"] = [f"{value:g}" for value in widths]

    cubes: dict[str, list[NDArray[Any]]] = {}
    planes: dict[str, NDArray[Any]] = {}
    for name, band, plane in layers(image):
        if band is None:
            planes[name] = plane
        else:
            cubes.setdefault(name, []).append(plane)
    about = plain_attributes(image)
    with staged(path, overwrite=overwrite) as partial:
        for name, cube in cubes.items():
            stem = partial.stem if name == "reflectance" else f"{partial.stem}_{name}"
            _write_cube(partial.with_name(f"{stem}.hdr"), np.stack(cube), name, spectral, about)
        labels = [f"{name} [{image[name].attrs.get('units', '1')}]" for name in planes]
        stacked = np.stack([plane.astype(np.float32) for plane in planes.values()])
        _write_cube(
            partial.with_name(f"{partial.stem}_planes.hdr"),
            stacked,
            "planes",
            {"band names": labels},
            about,
        )


def find_bad_bands(image: xr.Dataset) -> NDArray[np.bool_]:
    """Return which bands (band,) hold no value, or more noise than signal."""
    cube = image["reflectance"].transpose("band", "row", "col").values
    empty = np.array([not np.isfinite(plane).any() for plane in cube])
    if "reflectance_std" not in image:
        return empty
    noise = image["reflectance_std"].transpose("band", "row", "col").values
    bad = empty.copy()
    for band in np.flatnonzero(~empty):
        known = np.isfinite(cube[band]) & np.isfinite(noise[band])
        bad[band] = bool(known.any()) and bool(
            np.median(noise[band][known]) > np.median(cube[band][known])
        )
    return bad


def _write_cube(
    header: Path, cube: NDArray[Any], quantity: str, keys: dict[str, Any], about: dict[str, str]
) -> None:
    """Write raw little-endian numbers, band after band, and the header that describes them."""
    code = TYPE_CODES.get(cube.dtype.name)
    if code is None:
        raise ExportError(
            f"ENVI has no type for {cube.dtype} of {quantity!r}: convert it to one of "
            f"{', '.join(TYPE_CODES)}"
        )
    bands, rows, cols = cube.shape
    description = "; ".join(f"{key}: {value}" for key, value in about.items())
    entries: dict[str, Any] = {
        "description": [f"{quantity} of a Hueflight image; {description}"],
        "samples": cols,
        "lines": rows,
        "bands": bands,
        "header offset": 0,
        "file type": "ENVI Standard",
        "data type": code,
        "interleave": "bsq",
        "byte order": 0,
        **keys,
    }
    header.with_suffix(".img").write_bytes(cube.astype(cube.dtype.newbyteorder("<")).tobytes())
    lines = ["ENVI", *(f"{key} = {_value(value)}" for key, value in entries.items())]
    header.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _value(value: Any) -> str:
    if not isinstance(value, list):
        return str(value)
    # braces and line breaks would end the list, and commas would split a name
    clean = [str(item).replace("{", "(").replace("}", ")").replace("\n", " ") for item in value]
    if len(clean) > 1:
        clean = [item.replace(",", " ") for item in clean]
    return "{" + ", ".join(clean) + "}"
