# SPDX-License-Identifier: Apache-2.0
"""Images with positions as labels, whose plots are upright."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from hueflight.files.image_schema import instrument_of, require_image
from hueflight.model.instrument import Instrument


def upright(image: xr.Dataset, /, *, instrument: Instrument | None = None) -> xr.Dataset:
    """Label the pixels of an image by their positions, up and to the right of its center.

    Plots of xarray draw row 0 at the bottom, because its number is the smallest. With `up` and
    `right` instead of rows and columns, ``upright(image).depth.plot()`` is upright, and with a lens
    its axes are in degrees. Rows keep their numbers in the image itself, so that ``isel(row=3)``
    and plots with ``yincrease=False`` remain as they are.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    instrument : Instrument, optional
        Instrument that made the image; by default the one that the image describes, if it does.

    Returns
    -------
    xarray.Dataset
        The image with dimensions `up` and `right` instead of `row` and `col`: angles of the pixels
        against the optical axis in degrees where the instrument has a lens and the image all of
        its pixels, otherwise distances from the center in pixels, as their attribute `units` says.

    Raises
    ------
    ImageError
        If it is not an image, or `instrument` is not the one that made it.
    """
    require_image(image)
    if instrument is not None or "instrument_description" in image.attrs:
        instrument = instrument_of(image, instrument)
    rows, cols = image.sizes["row"], image.sizes["col"]
    about: dict[str, Any] = {"units": "pixel"}
    right, down = (np.arange(size) - (size - 1) / 2 for size in (cols, rows))
    if instrument is not None and instrument.lens and instrument.image_shape == (rows, cols):
        slopes = instrument.ray_slopes()
        right, down = (np.degrees(np.arctan(axis)) for axis in (slopes[0][0], slopes[1][:, 0]))
        about = {"units": "degree"}
    named = image.rename_dims(row="up", col="right")
    return named.assign_coords(
        up=("up", 0 - down, {"long_name": "up", **about}),
        right=("right", right, {"long_name": "right", **about}),
    )
