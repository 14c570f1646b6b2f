# SPDX-License-Identifier: Apache-2.0
"""Profiles of an image along a row or a column."""

from __future__ import annotations

import xarray as xr

from hueflight.analysis.regions import reliable
from hueflight.errors import HueflightError
from hueflight.files.image_schema import finite


def profile(
    image: xr.Dataset, /, *, row: int | None = None, col: int | None = None, half_width: int = 0
) -> xr.Dataset:
    """Extract depth and reflectance along one row or one column.

    Parameters
    ----------
    image : Dataset
        Image or series as `hueflight.reconstruct` gives.
    row, col : int or None
        Index of the row or of the column; give exactly one of them.
    half_width : int
        Number of neighbouring rows or columns on either side to average over.

    Returns
    -------
    Dataset
        Over the other direction: `depth`, `depth_std` (m), `reflectance` and `reflectance_std`
        (standard errors of the mean); NaN where no reliable pixel lies in the profile.

    Raises
    ------
    HueflightError
        If not exactly one of `row` and `col` is given, or it lies outside the image, or
        `half_width` is negative.
    """
    if (row is None) == (col is None):
        raise HueflightError(f"row = {row!r}, col = {col!r}: give exactly one of them")
    dim, index = ("row", row) if row is not None else ("col", col)
    assert index is not None  # one of the two was given
    size = image.sizes[dim]
    if not 0 <= index < size:
        raise HueflightError(f"{dim} = {index}: the image has {dim}s 0 to {size - 1}")
    if half_width < 0:
        raise HueflightError(f"half_width = {half_width}: must be 0 or more")
    strip = image.isel({dim: slice(max(0, index - half_width), index + half_width + 1)})
    good = reliable(strip)
    cut = {}
    for name in ("depth", "reflectance"):
        values, deviations = strip[name], strip[f"{name}_std"]
        usable = good & finite(values) & finite(deviations)
        count = usable.sum(dim)
        count = count.where(count > 0)
        mean = values.where(usable).sum(dim) / count
        error = (deviations.where(usable) ** 2).sum(dim) ** 0.5 / count
        cut[name] = mean.assign_attrs(values.attrs)
        cut[f"{name}_std"] = error.assign_attrs(deviations.attrs)
    return xr.Dataset(cut, attrs={**image.attrs, "cut": f"{dim} {index} ± {half_width}"})
