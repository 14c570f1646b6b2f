# SPDX-License-Identifier: Apache-2.0
"""Binary PLY, the point cloud format of most 3-D software.

This follows G. Turk, "The PLY Polygon File Format" (Stanford, 1994): a text header that names the
properties, then one packed record per vertex.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.errors import ExportError
from hueflight.export.description import ascii_text, plain_attributes
from hueflight.export.points import Points, image_points
from hueflight.files import staged
from hueflight.model.instrument import Instrument

LONGEST_COMMENT = 900  #: characters; some readers fail on lines of 1000 and more
PROPERTY_TYPES = {
    "float64": "double", "float32": "float", "int32": "int", "uint32": "uint",
    "int16": "short", "uint16": "ushort", "int8": "char", "uint8": "uchar",
}  # fmt: skip


def write_ply(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    instrument: Instrument | None = None,
    overwrite: bool = False,
) -> None:
    """Write an image as binary PLY: x y z in metres, sRGB, every band and uncertainty.

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
    points = image_points(image, instrument=instrument)
    content = ply_bytes(points, comments=plain_attributes(image))
    with staged(path, overwrite=overwrite) as partial:
        partial.write_bytes(content)


def ply_bytes(points: Points, *, comments: dict[str, str]) -> bytes:
    """Return the content of a PLY file with comments, which are written in ASCII."""
    columns = {
        **dict(zip("xyz", points.xyz.T, strict=True)),
        **dict(zip(("red", "green", "blue"), points.rgb.T, strict=True)),
        **points.fields,
    }
    # meshio reads no 16-bit types from binary files, the tensor reader of Open3D no unsigned ones
    columns = {name: _widened(values) for name, values in columns.items()}
    vertex = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    records = np.empty(len(points.xyz), dtype=vertex)
    for name, values in columns.items():
        records[name] = values
    remarks = ["metres; x right, y down, z from the camera along its axis"]
    remarks += [f"unit {name}: {unit}" for name, unit in points.units.items()]
    remarks += [f"{key}: {' '.join(value.split())}" for key, value in comments.items()]
    lines = ["ply", "format binary_little_endian 1.0"]
    for remark in remarks:
        text = ascii_text(remark)
        parts = range(0, max(1, len(text)), LONGEST_COMMENT)
        lines += [f"comment {text[at : at + LONGEST_COMMENT]}" for at in parts]
    lines.append(f"element vertex {len(records)}")
    for name, values in columns.items():
        kind = PROPERTY_TYPES.get(values.dtype.name)
        if kind is None:
            raise ExportError(f"PLY has no type for {values.dtype} of {name!r}: convert it first")
        lines.append(f"property {kind} {name}")
    lines.append("end_header\n")
    return "\n".join(lines).encode("utf-8") + records.tobytes()


def _widened(values: NDArray[Any]) -> NDArray[Any]:
    """Return 16-bit whole numbers with 32 bits and a sign, other values as they are."""
    wider = np.int32 if values.dtype.name in ("int16", "uint16") else None
    return values if wider is None else values.astype(wider)
