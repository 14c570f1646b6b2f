"""A picture as one binary message: a JSON header, and planes that a browser uploads as they are.

The message is, in this order: four bytes, little-endian, with the size of the header; the header,
padded with spaces so that the planes begin on a multiple of 8 bytes; the planes, in the order and
at the offsets that the header states. Values are quantised for display; exact numbers come from
``/api/pixel``.
"""

from __future__ import annotations

import struct
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from hueflight.daemon.live_color import LiveColor
from hueflight.daemon.picture import Picture

UNKNOWN = 65535  #: value of unknown pixels in 16-bit planes
_TOP_PERCENT = 99.0  #: percentile of a band's reflectance at the top of its scale


def encode_picture(picture: Picture, live_color: LiveColor, /) -> bytes:
    """Return the message of a picture.

    The planes are ``depth`` and ``depth_std`` (uint16, metres = value · scale), ``bands`` (uint8,
    (band, row, col), reflectance = top[band] · (value/255)²), ``colours`` (uint8, (row, col, 3),
    sRGB from all bands, if enough are visible), ``photons`` (uint16, clipped) and ``quality``
    (uint8, bits of `hueflight.reconstruction.quality.Quality`). Without a calibration there are
    only photons.

    Parameters
    ----------
    picture : Picture
        The picture.
    live_color : LiveColor
        Colours of the instrument's bands.

    Returns
    -------
    bytes
        The message.
    """
    planes: list[tuple[str, NDArray[Any]]] = [
        ("photons", np.minimum(picture.photons, UNKNOWN).astype("<u2"))
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
            plane, scale = _quantised(image[name].values)
            header[f"{name}_scale"] = scale
            planes.append((name, plane))
        cube = np.moveaxis(image["reflectance"].values, -1, 0)
        planes_8bit, tops = _square_root_coded(cube)
        header["tops"] = tops
        planes.append(("bands", planes_8bit))
        rgb = live_color.render(image)
        if rgb is not None:
            planes.append(("colours", rgb))
        planes.append(("quality", image["quality"].values.astype(np.uint8)))
    return _message(header, planes)


def _quantised(values: NDArray[np.floating]) -> tuple[NDArray[np.uint16], float]:
    """16-bit numbers and their unit; unknown pixels are `UNKNOWN`."""
    known = np.isfinite(values)
    top = float(values[known].max()) if known.any() else 1.0
    scale = max(top, 1e-6) / (UNKNOWN - 1)
    coded = np.full(values.shape, UNKNOWN, "<u2")
    coded[known] = np.clip(np.round(values[known] / scale), 0, UNKNOWN - 1)
    return coded, scale


def _square_root_coded(cube: NDArray[np.floating]) -> tuple[NDArray[np.uint8], list[float]]:
    """Each band on a square-root scale, shape (band, row, col), and the top of each scale."""
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
