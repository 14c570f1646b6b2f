"""A picture as one binary message: a JSON header and planes that a browser uploads as they are.

Layout: four bytes, little-endian, with the header's size; the header, padded with spaces so that
the planes begin on a multiple of 8; the planes, in the order and at the offsets it names.
Numbers are coded for the eye: the exact ones come from ``/api/pixel``.
"""

from __future__ import annotations

import struct
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from hueflight.daemon.live_color import Palette
from hueflight.daemon.pictures import Picture

NOT_KNOWN = 65535  #: of 16-bit planes
_TOP_PERCENT = 99.0  #: of a band's pixels fit its scale


def encode_picture(picture: Picture, palette: Palette, /) -> bytes:
    """The message of a picture.

    Planes are ``depth`` and ``depth_std`` (uint16, metres = value · scale), ``bands`` (uint8,
    (band, row, col), reflectance = top[band] · (value/255)²), ``colours`` (uint8, (row, col, 3),
    sRGB from all bands, if they can tell colours), ``photons`` (uint16, clipped) and ``quality``
    (uint8, bits of `Quality`). Without a calibration there are only photons.
    """
    planes: list[tuple[str, NDArray[Any]]] = [
        ("photons", np.minimum(picture.photons, NOT_KNOWN).astype("<u2"))
    ]
    header: dict[str, Any] = {
        "number": picture.number,
        "kind": picture.kind,
        "frames": picture.frames,
        "device_s": picture.device_s,
        "made_ms": round(1e3 * (picture.ready_s - picture.received_s), 2),
        "rows": picture.photons.shape[0],
        "cols": picture.photons.shape[1],
    }
    image = picture.image
    if image is not None:
        for name in ("depth", "depth_std"):
            plane, scale = _coded(image[name].values)
            header[f"{name}_scale"] = scale
            planes.append((name, plane))
        cube = np.moveaxis(image["reflectance"].values, -1, 0)
        coded, tops = _for_the_eye(cube)
        header["tops"] = tops
        planes.append(("bands", coded))
        colours = palette.colours(image)
        if colours is not None:
            planes.append(("colours", colours))
        planes.append(("quality", image["quality"].values.astype(np.uint8)))
    return _message(header, planes)


def _coded(values: NDArray[np.floating]) -> tuple[NDArray[np.uint16], float]:
    """16-bit numbers and their unit; what is not known is `NOT_KNOWN`."""
    known = np.isfinite(values)
    top = float(values[known].max()) if known.any() else 1.0
    scale = max(top, 1e-6) / (NOT_KNOWN - 1)
    coded = np.full(values.shape, NOT_KNOWN, "<u2")
    coded[known] = np.clip(np.round(values[known] / scale), 0, NOT_KNOWN - 1)
    return coded, scale


def _for_the_eye(cube: NDArray[np.floating]) -> tuple[NDArray[np.uint8], list[float]]:
    """Each band on a square-root scale of its own, (band, row, col)."""
    filled = np.nan_to_num(cube, nan=0.0, posinf=0.0, neginf=0.0)
    index = int(filled[0].size * _TOP_PERCENT / 100)
    flat = filled.reshape(len(filled), -1)
    tops = np.maximum(np.partition(flat, index, axis=1)[:, index], 1e-9)
    shares = np.sqrt(np.clip(filled / tops[:, None, None], 0, 1))
    return (shares * 255 + 0.5).astype(np.uint8), [float(top) for top in tops]


def _message(header: dict[str, Any], planes: list[tuple[str, NDArray[Any]]]) -> bytes:
    listed, offset = [], 0
    for name, plane in planes:
        listed.append(
            {"name": name, "type": plane.dtype.name, "shape": list(plane.shape), "offset": offset}
        )
        offset += -(-plane.nbytes // 8) * 8
    text = msgspec.json.encode(header | {"planes": listed})
    text += b" " * (-(4 + len(text)) % 8)
    body = bytearray(offset)
    for entry, (_, plane) in zip(listed, planes, strict=True):
        body[entry["offset"] : entry["offset"] + plane.nbytes] = plane.tobytes()
    return struct.pack("<I", len(text)) + text + bytes(body)
