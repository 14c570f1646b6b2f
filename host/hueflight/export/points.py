# SPDX-License-Identifier: Apache-2.0
"""Point clouds from images, by the lens model of the instrument.

Coordinates are metres in the frame of the camera: x right, y down, z along the optical axis away
from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color import color_picture
from hueflight.errors import ExportError
from hueflight.export.description import band_labels
from hueflight.files.image_schema import SERIES_DIM, instrument_of, require_image
from hueflight.model.instrument import Instrument


@dataclass(frozen=True)
class Points:
    """A point cloud: every pixel of an image that has a depth, row by row.

    Attributes
    ----------
    xyz : numpy.ndarray, shape (point, 3)
        Coordinates in metres.
    rgb : numpy.ndarray, uint8, shape (point, 3)
        Colours in sRGB.
    fields : dict of str to numpy.ndarray, shape (point,)
        Row, column and the values of every plane and band of the image, by name.
    units : dict of str to str
        Unit of each field.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    fields: dict[str, NDArray[Any]]
    units: dict[str, str]


def image_points(
    image: xr.Dataset,
    /,
    *,
    instrument: Instrument | None = None,
    rgb: NDArray[np.uint8] | None = None,
) -> Points:
    """Compute the point cloud of an image.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    instrument : Instrument, optional
        Instrument whose lens gives the direction of each pixel; by default the one that the image
        describes.
    rgb : ndarray of uint8, shape (row, col, 3), optional
        Colours of the pixels; by default those of `hueflight.color.color_picture`.

    Returns
    -------
    Points
        The point cloud.

    Raises
    ------
    ExportError
        If the image is a series, has no pixel with a depth, or no instrument is known.
    """
    require_image(image)
    if SERIES_DIM in image.dims:
        raise ExportError(f"a point cloud holds one image: select one {SERIES_DIM!r} of the series")
    source = instrument_of(image, instrument)
    depth = image["depth"].transpose("row", "col").values.astype(np.float64)
    if depth.shape != source.image_shape:
        raise ExportError(
            f"the image has {depth.shape} pixels, instrument {source.name!r} has "
            f"{source.image_shape}: cut-out images lose their pixels' directions; export the "
            "whole and cut the points"
        )
    known = np.isfinite(depth)
    if not known.any():
        raise ExportError("no pixel of the image has a depth: there are no points to write")
    places = np.flatnonzero(known)
    xyz = np.empty((places.size, 3))
    for axis, slopes in enumerate(source.ray_slopes()):
        xyz[:, axis] = slopes.ravel()[places]
    xyz[:, 2] = 1.0
    xyz *= depth.ravel()[places][:, None]
    row, col = np.divmod(places, depth.shape[1])
    fields: dict[str, NDArray[Any]] = {"row": row.astype(np.uint16), "col": col.astype(np.uint16)}
    units = {"row": "1", "col": "1"}
    labels = band_labels(image)
    for name in image.data_vars:
        variable = image.variables[name]
        unit = str(variable.attrs.get("units", "1"))
        if "band" in variable.dims:
            cube = variable.transpose("band", "row", "col").values
            found = cube.reshape(len(cube), -1).take(places, axis=1)
            for label, plane in zip(labels, found, strict=True):
                fields[f"{name}_{label}"], units[f"{name}_{label}"] = plane, unit
        elif name != "depth":  # which is z
            fields[str(name)] = variable.transpose("row", "col").values.ravel()[places]
            units[str(name)] = unit
    if rgb is None:
        rgb = np.rint(color_picture(image, instrument=source) * 255).astype(np.uint8)
    return Points(xyz=xyz, rgb=rgb.reshape(-1, 3)[places], fields=fields, units=units)
