# SPDX-License-Identifier: Apache-2.0
"""What a valid image is, or a series of images: dimensions and variables that writers need."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ImageError
from hueflight.model.instrument import Instrument

SERIES_DIM = "capture"  #: leading dimension of a series of images
CAPTURE_NAME = "capture_name"  #: names of the captures in NetCDF, where no index may be text


def require_image(image: xr.Dataset) -> None:
    """Check that a dataset is an image or a series of images.

    Parameters
    ----------
    image : xarray.Dataset
        The dataset to check.

    Raises
    ------
    ImageError
        If a dimension, coordinate or variable is missing, or a variable can't be stored.
    """
    if not isinstance(image, xr.Dataset):
        raise ImageError(f"an image is an xarray.Dataset as reconstruct gives, not {type(image)}")
    missing = [dim for dim in ("row", "col", "band") if dim not in image.dims]
    missing += [name for name in ("wavelength",) if name not in image.coords]
    missing += [name for name in ("depth", "reflectance", "quality") if name not in image]
    if missing:
        raise ImageError(
            f"this dataset is no image: it lacks {', '.join(missing)}; it has "
            f"{', '.join(map(str, [*image.dims, *image.variables]))}"
        )
    for name, variable in image.data_vars.items():
        extra = [dim for dim in variable.dims if dim not in (SERIES_DIM, "row", "col", "band")]
        if extra:
            raise ImageError(
                f"image[{name!r}] has the dimension {extra[0]!r}; an image has row, col and band, "
                f"a series also {SERIES_DIM!r}: select one of {extra[0]!r} first"
            )
        if variable.dtype.kind not in "fiub":
            raise ImageError(
                f"image[{name!r}] has type {variable.dtype}, which no format here holds: convert "
                "it to a number first"
            )


def finite(values: xr.DataArray) -> xr.DataArray:
    """Give where values are finite numbers, with the same labels."""
    return values.copy(data=np.isfinite(values.values))


def captures(image: xr.Dataset) -> list[xr.Dataset]:
    """Split a series into its images; a single image is a list of one."""
    if SERIES_DIM not in image.dims:
        return [image]
    return [image.isel({SERIES_DIM: index}) for index in range(image.sizes[SERIES_DIM])]


def layers(image: xr.Dataset) -> list[tuple[str, int | None, NDArray[Any]]]:
    """List all planes of one image as (variable, band or None, values (row, col))."""
    found: list[tuple[str, int | None, NDArray[Any]]] = []
    for name, variable in image.data_vars.items():
        if "band" in variable.dims:
            cube = variable.transpose("band", "row", "col").values
            found += [(str(name), band, plane) for band, plane in enumerate(cube)]
        else:
            found.append((str(name), None, variable.transpose("row", "col").values))
    return found


def instrument_of(image: xr.Dataset, instrument: Instrument | None = None) -> Instrument:
    """Find the instrument of an image.

    Parameters
    ----------
    image : xarray.Dataset
        An image, whose attributes may describe the instrument.
    instrument : Instrument, optional
        The instrument, if it is known.

    Returns
    -------
    Instrument
        The instrument given, or the one that the image describes.

    Raises
    ------
    ImageError
        If there is neither, or the instrument given is not the one that made the image.
    """
    if instrument is None:
        text = image.attrs.get("instrument_description")
        if text is None:
            raise ImageError(
                "the image does not describe its instrument, which the points' positions need: "
                "pass instrument=, or describe(image, calibration) before exporting"
            )
        return Instrument.from_json(text, where="instrument_description of the image")
    made_by = image.attrs.get("instrument_fingerprint")
    if made_by is not None and made_by != instrument.fingerprint():
        raise ImageError(
            f"the image comes from instrument {image.attrs.get('instrument')!r} ({made_by}), not "
            f"from {instrument.name!r} ({instrument.fingerprint()})"
        )
    return instrument
