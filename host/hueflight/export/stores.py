# SPDX-License-Identifier: Apache-2.0
"""Zarr stores and NetCDF files, which hold the complete image with its labels."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import xarray as xr

from hueflight.export.description import with_conventions
from hueflight.export.hdf5 import buffering_file
from hueflight.files import ZARR_FORMAT, import_optional, staged, write_checksums
from hueflight.files.bands import has_band_labels
from hueflight.files.image_schema import CAPTURE_NAME, SERIES_DIM, require_image


def write_zarr(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Write an image or series as a Zarr store, with one chunk per capture and variable.

    The store has Zarr format 2 with consolidated metadata, which every Zarr library reads; format 3
    has no standard yet for arrays of text, such as the names of the bands. A list of the checksums
    of all files is stored with them, which `hueflight.importers.read_image` verifies.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the store.
    overwrite : bool
        Whether an existing store of this name may be replaced.

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
    # without the encoding of the file that it was read from, which may not fit the new one
    described = with_conventions(image).drop_encoding()
    encoding: dict[Any, dict[str, Any]] = {
        name: {
            "chunks": tuple(
                1 if dim == SERIES_DIM else size
                for dim, size in zip(variable.dims, variable.shape, strict=True)
            ),
        }
        for name, variable in described.data_vars.items()
    }
    with staged(path, overwrite=overwrite) as partial:
        described.to_zarr(
            partial, mode="w", zarr_format=ZARR_FORMAT, consolidated=True, encoding=encoding
        )
        write_checksums(partial)


def write_netcdf(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Write an image or series as a NetCDF-4 file with lossless compression.

    The file follows the CF conventions. They allow only numbers in a coordinate of the same name as
    its dimension, so that the labels of `band` are in `band_name` alone, and those of `capture` in
    `capture_name`; `hueflight.importers.read_image` restores them. The attribute `history` says
    when and by which program an image was first written as NetCDF.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the file.
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
    import_optional("h5netcdf", extra="export")
    # without the encoding of the file that it was read from, which may not fit the new one
    described = _with_history(_without_text_index(with_conventions(image))).drop_encoding()
    encoding: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "shuffle": True} for name in described.data_vars
    }
    with staged(path, overwrite=overwrite) as partial, buffering_file(partial) as file:
        described.to_netcdf(file, engine="h5netcdf", encoding=encoding)


def _without_text_index(image: xr.Dataset) -> xr.Dataset:
    """Keep labels that are text in coordinates of other names, from which `read_image` has them."""

    def is_text(name: str) -> bool:
        return name in image.coords and image[name].dtype.kind in "OUST"

    if has_band_labels(image) and is_text("band"):
        image = image.drop_vars("band")
    if is_text(SERIES_DIM):
        names = image[SERIES_DIM].variable
        image = image.drop_vars(SERIES_DIM).assign_coords({CAPTURE_NAME: names})
    return image


def _with_history(image: xr.Dataset) -> xr.Dataset:
    """Begin the history of the file, with time and program, unless it has one (CF 2.6.2)."""
    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{when}: written by {image.attrs.get('software', 'hueflight')}"
    return image.assign_attrs({"history": line, **image.attrs})
