"""PLY, binary: the point cloud format that nearly every 3-D program opens.

After G. Turk, "The PLY Polygon File Format" (Stanford, 1994): a text header that names the
properties, then one packed record per vertex.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from hueflight.errors import ExportError
from hueflight.export.description import plain_attributes
from hueflight.export.points import Points, image_points
from hueflight.files import staged
from hueflight.model.instrument import Instrument

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
    """One image as a binary PLY: x y z in metres, sRGB, every band and uncertainty."""
    points = image_points(image, instrument=instrument)
    content = ply_bytes(points, comments=plain_attributes(image))
    with staged(path, overwrite=overwrite) as partial:
        partial.write_bytes(content)


def ply_bytes(points: Points, *, comments: dict[str, str]) -> bytes:
    """The whole file."""
    columns = {
        **dict(zip("xyz", points.xyz.T, strict=True)),
        **dict(zip(("red", "green", "blue"), points.rgb.T, strict=True)),
        **points.fields,
    }
    vertex = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    records = np.empty(len(points.xyz), dtype=vertex)
    for name, values in columns.items():
        records[name] = values
    lines = ["ply", "format binary_little_endian 1.0"]
    lines.append("comment metres; x right, y down, z from the camera along its axis")
    lines += [f"comment unit {name}: {unit}" for name, unit in points.units.items()]
    lines += [f"comment {key}: {' '.join(value.split())}" for key, value in comments.items()]
    lines.append(f"element vertex {len(records)}")
    for name, values in columns.items():
        kind = PROPERTY_TYPES.get(values.dtype.name)
        if kind is None:
            raise ExportError(f"PLY has no type for {values.dtype} of {name!r}: convert it first")
        lines.append(f"property {kind} {name}")
    lines.append("end_header\n")
    return "\n".join(lines).encode("utf-8") + records.tobytes()
