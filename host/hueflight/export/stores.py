"""Zarr stores and NetCDF files: the whole image with its labels, as xarray reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from hueflight.export.description import with_conventions
from hueflight.export.hdf5 import patient_file
from hueflight.files import ZARR_FORMAT, import_optional, staged, write_checksums
from hueflight.files.image_schema import SERIES_DIM, require_image


def write_zarr(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Image or series as a Zarr store, one chunk per capture and variable.

    Zarr format 2 with consolidated metadata: every Zarr library reads it, and format 3 has no
    settled way to write the bands' names yet. A list of all files with their checksums lies
    beside them, which `hueflight.importers.read_image` holds the store against.
    """
    require_image(image)
    # without traces of the file it was read from, which may not fit the new one
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
    """Image or series as a NetCDF-4 file, compressed without loss."""
    require_image(image)
    import_optional("h5netcdf", extra="export")
    # without traces of the file it was read from, which may not fit the new one
    described = with_conventions(image).drop_encoding()
    encoding: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "shuffle": True} for name in described.data_vars
    }
    with staged(path, overwrite=overwrite) as partial, patient_file(partial) as file:
        described.to_netcdf(file, engine="h5netcdf", encoding=encoding)
