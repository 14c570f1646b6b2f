# SPDX-License-Identifier: Apache-2.0
"""LAS 1.4 point clouds, for lidar software: bands and uncertainties as extra dimensions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ExportError
from hueflight.export.description import ascii_text, plain_attributes
from hueflight.export.points import image_points
from hueflight.files import import_optional, staged
from hueflight.model.instrument import Instrument

POINT_FORMAT = 7  #: of LAS 1.4, with colour
RESOLUTION_M = 1e-5  #: coordinates are multiples of it, unless they exceed 21 km
LARGEST_COUNT = 2**31 - 1  #: of a coordinate, in multiples of the resolution
NAME_BYTES = 32  #: the format's limit for a dimension's name and its description


def write_las(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    instrument: Instrument | None = None,
    overwrite: bool = False,
) -> None:
    """Write an image as LAS 1.4: x y z in metres, 16-bit RGB, every band and uncertainty.

    `intensity` is the mean reflectance over all bands, with full scale at 1. The metadata of the
    image are stored as JSON in a variable length record of the user "hueflight". LAS text fields
    hold ASCII only.

    Parameters
    ----------
    image : xarray.Dataset
        One image.
    path : str or pathlib.Path
        Name of the file.
    instrument : Instrument, optional
        Instrument whose lens gives the direction of each pixel; by default the one that the image
        describes.
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
    laspy = import_optional("laspy", extra="export")
    points = image_points(image, instrument=instrument)
    if too_long := [name for name in points.fields if len(name) > NAME_BYTES]:
        raise ExportError(f"LAS names have at most {NAME_BYTES} characters: rename {too_long[0]!r}")
    header = laspy.LasHeader(point_format=POINT_FORMAT, version="1.4")
    header.generating_software = ascii_text(str(image.attrs.get("software", "hueflight")))[
        :NAME_BYTES
    ]
    header.system_identifier = ascii_text(str(image.attrs.get("instrument", "")))[:NAME_BYTES]
    header.scales = np.full(3, _resolution_m(points.xyz))
    header.offsets = np.zeros(3)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(
                name,
                values.dtype,
                description=ascii_text(f"unit {points.units[name]}")[:NAME_BYTES],
            )
            for name, values in points.fields.items()
        ]
    )
    origin = json.dumps(plain_attributes(image)).encode()
    header.vlrs.append(laspy.VLR("hueflight", 1, "origin of the image, JSON", origin[:65535]))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.xyz.T
    # 8 to 16 bits: 255 must become 65535
    las.red, las.green, las.blue = points.rgb.T.astype(np.uint16) * 257
    bright = image["reflectance"].mean("band").transpose("row", "col").values
    bright = bright[points.fields["row"], points.fields["col"]]
    las.intensity = np.rint(np.clip(np.nan_to_num(bright), 0, 1) * 65535).astype(np.uint16)
    las.return_number[:] = 1
    las.number_of_returns[:] = 1
    for name, values in points.fields.items():
        las[name] = values
    with staged(path, overwrite=overwrite) as partial:
        las.write(str(partial))


def _resolution_m(xyz: NDArray[np.float64]) -> float:
    """Return the resolution of coordinates: the usual one, or a power of ten that is enough."""
    largest = float(np.abs(xyz).max())
    resolution = RESOLUTION_M
    while largest > resolution * LARGEST_COUNT:
        resolution *= 10
    return resolution
