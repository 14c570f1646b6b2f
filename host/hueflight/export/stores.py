"""Zarr stores and NetCDF files: the whole image with its labels, as xarray reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from hueflight.export.description import with_conventions
from hueflight.export.hdf5 import patient_file
from hueflight.export.staging import optional, staged
from hueflight.images import SERIES_DIM, require_image


def write_zarr(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Image or series as a Zarr store, one chunk per capture and variable.

    Zarr format 2 with consolidated metadata: every Zarr library reads it, and format 3 has no
    settled way to write the bands' names yet. Chunks without data are written too, so that a
    missing file always means a damaged store.
    """
    require_image(image)
    described = with_conventions(image)
    encoding: dict[Any, dict[str, Any]] = {
        name: {
            "chunks": tuple(
                1 if dim == SERIES_DIM else size
                for dim, size in zip(variable.dims, variable.shape, strict=True)
            ),
            "write_empty_chunks": True,
        }
        for name, variable in described.data_vars.items()
    }
    with staged(path, overwrite=overwrite) as partial:
        _forget_encoding(described).to_zarr(
            partial, mode="w", zarr_format=2, consolidated=True, encoding=encoding
        )


def write_netcdf(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Image or series as a NetCDF-4 file, compressed without loss."""
    require_image(image)
    optional("h5netcdf")
    described = with_conventions(image)
    encoding: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "shuffle": True} for name in described.data_vars
    }
    with staged(path, overwrite=overwrite) as partial, patient_file(partial) as file:
        _forget_encoding(described).to_netcdf(file, engine="h5netcdf", encoding=encoding)


def _forget_encoding(image: xr.Dataset) -> xr.Dataset:
    """Without traces of the file it was read from, which may not fit the new one."""
    return image.drop_encoding()
