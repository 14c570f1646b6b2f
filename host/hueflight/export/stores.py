# SPDX-License-Identifier: Apache-2.0
"""Zarr stores and NetCDF files, which hold the complete image with its labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from hueflight.export.description import with_conventions
from hueflight.export.hdf5 import buffering_file
from hueflight.files import ZARR_FORMAT, import_optional, staged, write_checksums
from hueflight.files.image_schema import SERIES_DIM, require_image


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
    described = with_conventions(image).drop_encoding()
    encoding: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "shuffle": True} for name in described.data_vars
    }
    with staged(path, overwrite=overwrite) as partial, buffering_file(partial) as file:
        described.to_netcdf(file, engine="h5netcdf", encoding=encoding)
