"""LAS 1.4 point clouds, for lidar software: bands and uncertainties as extra dimensions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr

from hueflight.errors import ExportError
from hueflight.export.description import plain_attributes
from hueflight.export.points import image_points
from hueflight.files import import_optional, staged
from hueflight.model.instrument import Instrument

POINT_FORMAT = 7  #: of LAS 1.4, with colour
RESOLUTION_M = 1e-5  #: coordinates are whole multiples; a 32-bit count reaches 21 km
NAME_BYTES = 32  #: the format's limit for a dimension's name and its description


def write_las(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    instrument: Instrument | None = None,
    overwrite: bool = False,
) -> None:
    """One image as LAS 1.4: x y z in metres, 16-bit RGB, every band and uncertainty.

    `intensity` is the mean reflectance over all bands, full scale at 1. The image's origin
    stands as JSON in a variable length record of the user "hueflight".
    """
    laspy = import_optional("laspy", extra="export")
    points = image_points(image, instrument=instrument)
    if too_long := [name for name in points.fields if len(name) > NAME_BYTES]:
        raise ExportError(f"LAS names have at most {NAME_BYTES} characters: rename {too_long[0]!r}")
    header = laspy.LasHeader(point_format=POINT_FORMAT, version="1.4")
    header.generating_software = str(image.attrs.get("software", "hueflight"))[:NAME_BYTES]
    header.system_identifier = str(image.attrs.get("instrument", ""))[:NAME_BYTES]
    header.scales = np.full(3, RESOLUTION_M)
    header.offsets = np.zeros(3)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(
                name, values.dtype, description=f"unit {points.units[name]}"[:NAME_BYTES]
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
