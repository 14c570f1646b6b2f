# SPDX-License-Identifier: Apache-2.0
"""Mean spectra and distances of named regions of an image, with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import HueflightError
from hueflight.files.image_schema import SERIES_DIM, finite
from hueflight.reconstruction.quality import Quality

#: mask (row, col), or a pair of slices
Region: TypeAlias = NDArray[np.bool_] | tuple[slice, slice]

UNRELIABLE = (
    Quality.DEAD
    | Quality.HOT
    | Quality.SATURATED
    | Quality.AMBIGUOUS_LAG
    | Quality.MISFIT
    | Quality.SKIPPED
    | Quality.MIXED
    | Quality.TWO_RETURNS
    | Quality.CONTRADICTED
    | Quality.PILED_UP
)


def reliable(image: xr.Dataset, /) -> xr.DataArray:
    """Find the pixels whose quality flags allow averaging.

    Parameters
    ----------
    image : Dataset
        Image or series as `hueflight.reconstruct` gives.

    Returns
    -------
    DataArray of bool, dims (..., row, col)
        False where a pixel has a flag of `UNRELIABLE`, such as dead, saturated or mixed.
    """
    return (image["quality"] & int(UNRELIABLE)) == 0


def region_spectra(image: xr.Dataset, regions: Mapping[str, Region], /) -> xr.Dataset:
    """Average reflectance and depth over each region.

    Parameters
    ----------
    image : Dataset
        One image as `hueflight.reconstruct` gives, or a series with a leading dimension.
    regions : mapping of str to Region
        Boolean mask (row, col), or a pair of slices (rows, columns), by name.

    Returns
    -------
    Dataset
        Over (region, band): `reflectance`, its standard error by photon noise `reflectance_std`,
        and `reflectance_scatter`, the standard deviation from pixel to pixel, which texture and
        uneven light increase. Over (region,): `depth`, `depth_std`, `depth_scatter` (m) and
        `pixels`. Pixels that are not `reliable` are left out.

    Raises
    ------
    HueflightError
        If there is no region, or one does not fit the image or holds no pixel of it.

    Notes
    -----
    The standard error takes pixels as independent: √Σσᵢ² / n. It does not hold where
    neighbours were smoothed together.
    """
    if not regions:
        raise HueflightError("regions is empty: name at least one, as a mask or a pair of slices")
    shape = (image.sizes["row"], image.sizes["col"])
    masks = [region_mask(region, shape, name=name) for name, region in regions.items()]
    means = [_region_mean(image, mask) for mask in masks]
    spectra = xr.concat(means, dim="region").assign_coords(region=list(regions))
    spectra = spectra.transpose(SERIES_DIM, "region", "band", missing_dims="ignore")
    spectra.attrs = {**image.attrs, "title": "Mean spectra of regions"}
    return spectra


def region_mask(
    region: Region, shape: tuple[int, int], *, name: str = "region"
) -> NDArray[np.bool_]:
    """Convert a region to a mask.

    Parameters
    ----------
    region : Region
        Boolean mask (row, col), or a pair of slices (rows, columns).
    shape : tuple of int
        Rows and columns of the image.
    name : str
        Name of the region in errors.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True inside the region.

    Raises
    ------
    HueflightError
        If the region does not fit the image, or holds no pixel of it.
    """
    if isinstance(region, tuple):
        mask = np.zeros(shape, dtype=bool)
        mask[region] = True
    else:
        mask = np.asarray(region)
        if mask.shape != shape or mask.dtype != np.bool_:
            raise HueflightError(
                f"region {name!r} is {mask.dtype} of shape {mask.shape}: give a boolean mask of "
                f"the image's shape {shape}, or two slices"
            )
    if not mask.any():
        raise HueflightError(f"region {name!r} holds no pixel of the {shape[0]}×{shape[1]} image")
    return mask


def parse_region(text: str) -> tuple[str, tuple[slice, slice]]:
    """Parse a region written as ``NAME=ROW:ROW,COL:COL``.

    Parameters
    ----------
    text : str
        Name, first row and the row after the last, then the same for columns. Ends may be left out,
        as in a slice.

    Returns
    -------
    name : str
        Name of the region.
    slices : tuple of slice
        Rows and columns.

    Raises
    ------
    HueflightError
        If the text has another form.

    Examples
    --------
    >>> parse_region("wall=20:60,:40")
    ('wall', (slice(20, 60, None), slice(None, 40, None)))
    """
    name, _, ranges = text.partition("=")
    parts = ranges.split(",")
    try:
        bounds = [[int(end) if end.strip() else None for end in part.split(":")] for part in parts]
        if not name.strip() or len(bounds) != 2 or any(len(ends) != 2 for ends in bounds):
            raise ValueError
    except ValueError:
        raise HueflightError(
            f"region {text!r}: write NAME=ROW:ROW,COL:COL, such as wall=20:60,10:40"
        ) from None
    rows, cols = bounds
    return name.strip(), (slice(*rows), slice(*cols))


def _region_mean(image: xr.Dataset, mask: NDArray[np.bool_]) -> xr.Dataset:
    chosen = xr.DataArray(mask, dims=("row", "col")) & reliable(image)
    found = {"pixels": (chosen & finite(image["depth"])).sum(("row", "col"))}
    for name in ("reflectance", "depth"):
        unit = {"units": image[name].attrs.get("units", "1")}
        for key, value in _mean(image[name], image[f"{name}_std"], chosen).items():
            found[f"{name}{key}"] = value.assign_attrs(unit)
    found["pixels"].attrs = {"units": "count", "long_name": "pixels with a depth"}
    return xr.Dataset(found)


def _mean(
    values: xr.DataArray, deviations: xr.DataArray, chosen: xr.DataArray
) -> dict[str, xr.DataArray]:
    """Mean, its standard error and the scatter between pixels; suffix → value."""
    usable = chosen & finite(values) & finite(deviations)
    kept = values.where(usable).astype(np.float64)
    plane = ("row", "col")
    count = usable.sum(plane)
    known = count > 0
    mean = kept.sum(plane) / count.where(known)
    variance = (deviations.where(usable).astype(np.float64) ** 2).sum(plane)
    spread = ((kept - mean) ** 2).sum(plane) / (count - 1).where(count > 1)
    return {
        "": mean.assign_attrs(long_name=f"mean {values.name}"),
        "_std": (variance**0.5 / count.where(known)).assign_attrs(
            long_name=f"standard error of mean {values.name}, photon noise"
        ),
        "_scatter": (spread**0.5).assign_attrs(
            long_name=f"standard deviation of {values.name} between pixels"
        ),
    }
