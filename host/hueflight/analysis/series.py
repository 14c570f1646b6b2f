# SPDX-License-Identifier: Apache-2.0
"""Series of captures: stacking images, and trends in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from hueflight.errors import HueflightError
from hueflight.files.image_schema import SERIES_DIM, finite
from hueflight.reconstruction.range_correction import require_same_range_correction

SHARED = ("instrument", "instrument_fingerprint")  #: must agree within a series


def stack(
    images: Sequence[xr.Dataset],
    /,
    *,
    names: Sequence[str] | None = None,
    time: ArrayLike | None = None,
) -> xr.Dataset:
    """Stack images along a new dimension `capture`.

    Parameters
    ----------
    images : sequence of Dataset
        Images of one instrument, in order.
    names : sequence of str or None
        Names of the captures; None for their numbers.
    time : array_like or None, shape (capture,)
        When each image was taken, in seconds or as `datetime64`; becomes the coordinate `time`.

    Returns
    -------
    Dataset
        The series.

    Raises
    ------
    HueflightError
        If there are no images, their instruments, shapes or range corrections differ, or there is
        not one name or time for each image.
    """
    if not images:
        raise HueflightError("a series needs at least one image")
    first = images[0]
    for number, image in enumerate(images):
        for key in SHARED:
            if image.attrs.get(key) != first.attrs.get(key):
                raise HueflightError(
                    f"image {number} has {key} {image.attrs.get(key)!r}, image 0 "
                    f"{first.attrs.get(key)!r}: a series holds images of one instrument"
                )
        if dict(image.sizes) != dict(first.sizes) or set(image) != set(first):
            raise HueflightError(
                f"image {number} holds {sorted(map(str, image))} of {dict(image.sizes)}, image 0 "
                f"{sorted(map(str, first))} of {dict(first.sizes)}: reconstruct them alike"
            )
    require_same_range_correction(images)
    labels = list(names) if names is not None else [str(number) for number in range(len(images))]
    if len(labels) != len(images):
        raise HueflightError(f"{len(labels)} names for {len(images)} images")
    series = xr.concat(list(images), dim=SERIES_DIM, combine_attrs="drop_conflicts")
    series = series.assign_coords({SERIES_DIM: labels})
    if time is not None:
        when = np.asarray(time)
        if when.shape != (len(images),):
            raise HueflightError(f"time has shape {when.shape} for {len(images)} images")
        about = {"long_name": "time of the capture"}
        if when.dtype.kind != "M":
            about["units"] = "s"
        series = series.assign_coords(time=(SERIES_DIM, when, about))
    return series


def trend(values: xr.DataArray, deviations: xr.DataArray, /) -> xr.Dataset:
    """Fit a straight line through a series by weighted least squares, for each pixel or region.

    Parameters
    ----------
    values, deviations : DataArray, dims (capture, ...)
        Measured values and their standard deviations, such as two variables of a series or of its
        `region_spectra`. The coordinate `time` gives the times; without it captures are numbered
        0, 1, and so on.

    Returns
    -------
    Dataset
        `slope` and `slope_std` (per second, or per capture), `mean` at the weighted mean time with
        `mean_std`, and `chi2_per_degree`: near 1 where a line explains the values, NaN for two
        captures. All are NaN where fewer than two captures have a value.

    Raises
    ------
    HueflightError
        If there are fewer than two captures, or all were taken at one time.

    Notes
    -----
    Bevington and Robinson, Data Reduction and Error Analysis, 3rd ed., ch. 6.
    """
    if values.sizes.get(SERIES_DIM, 0) < 2:
        raise HueflightError(f"a trend needs at least two captures; got {dict(values.sizes)}")
    seconds = _seconds(values)
    if np.ptp(seconds.values) == 0:
        raise HueflightError("all captures have the same time: there is no trend to find")
    usable = finite(values) & finite(deviations) & (deviations > 0)
    usable = usable & (usable.sum(SERIES_DIM) >= 2)
    weight = (1 / deviations.astype(np.float64) ** 2).where(usable, 0.0)
    total = weight.sum(SERIES_DIM)
    total = total.where(total > 0)
    filled = values.astype(np.float64).where(usable, 0.0)
    middle = (weight * seconds).sum(SERIES_DIM) / total
    lever = seconds - middle
    moment = (weight * lever**2).sum(SERIES_DIM)
    moment = moment.where(moment > 0)
    mean = (weight * filled).sum(SERIES_DIM) / total
    slope = (weight * lever * filled).sum(SERIES_DIM) / moment
    residual = weight * (filled - mean - slope * lever) ** 2
    degrees = usable.sum(SERIES_DIM) - 2
    return xr.Dataset(
        {
            "slope": slope,
            "slope_std": moment**-0.5,
            "mean": mean,
            "mean_std": total**-0.5,
            "chi2_per_degree": residual.sum(SERIES_DIM) / degrees.where(degrees > 0),
        }
    )


def _seconds(values: xr.DataArray) -> xr.DataArray:
    """When each capture was taken, seconds since the first."""
    if "time" not in values.coords:
        return xr.DataArray(np.arange(values.sizes[SERIES_DIM], dtype=np.float64), dims=SERIES_DIM)
    when = values["time"].values
    since = when - when[0]
    if since.dtype.kind == "m":
        since = since / np.timedelta64(1, "s")
    return xr.DataArray(since.astype(np.float64), dims=SERIES_DIM)
