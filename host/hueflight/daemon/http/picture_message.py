# SPDX-License-Identifier: Apache-2.0
"""A picture as one binary message; `hueflight.live.message` describes how messages are laid out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.color.live_color import LiveColor, sampling_step
from hueflight.daemon.picture import Picture
from hueflight.live.image import message_of_image
from hueflight.live.message import Plane, encode_message
from hueflight.live.protocol import Coding

UNKNOWN = 65535  #: value of unknown pixels in 16-bit planes
_TOP_PERCENT = 99.0  #: percentile of a band's reflectance at the top of its scale
_MOST_FRAMES = np.iinfo(np.uint32).max
_PLANE = ("row", "col")


def encode_picture(
    picture: Picture, live_color: LiveColor, /, *, coding: Coding = "display"
) -> bytes:
    """Return the message of a picture.

    With the coding ``"exact"``, the planes are the variables of the image, and their values are
    those of the reconstruction. With ``"display"``, they are ``depth`` and ``depth_std`` (uint16,
    metres = value · scale), ``bands`` (uint8, (band, row, col), reflectance = top[band] ·
    (value/255)²), ``colours`` (uint8, (row, col, 3), sRGB from all bands, if enough are visible),
    ``photons`` and ``frames`` (uint32, frames behind each pixel) and ``quality``
    (uint16, bits of `hueflight.reconstruction.quality.Quality`). Without a calibration there are
    only photons and frames.

    Parameters
    ----------
    picture : Picture
        The picture.
    live_color : LiveColor
        Colours of the instrument's bands.
    coding : str
        ``"display"`` or ``"exact"``.

    Returns
    -------
    bytes
        The message.
    """
    header: dict[str, Any] = {
        "number": picture.number,
        "kind": picture.kind,
        "frames": picture.frames,
        "device_s": picture.device_s,
        "received_unix_s": picture.received_unix_s(),
        "made_ms": round(1e3 * (picture.ready_s - picture.received_s), 2),
        "rows": picture.photons.shape[0],
        "cols": picture.photons.shape[1],
    }
    if coding == "exact":
        return message_of_image(picture.exact(), header)
    return _for_display(picture, live_color, header)


def _for_display(picture: Picture, live_color: LiveColor, header: dict[str, Any]) -> bytes:
    planes = [Plane("photons", picture.photons.astype("<u4"), _PLANE)]
    frames = picture.frames_by_pixel
    if picture.frames > _MOST_FRAMES:
        frames = np.minimum(frames, _MOST_FRAMES)
    planes.append(Plane("frames", frames.astype("<u4"), _PLANE))
    if picture.image is not None:
        image = picture.image.variables  # without labels, which cost more than the arrays
        for name in ("depth", "depth_std"):
            values, scale = _quantised(image[name].values)
            header[f"{name}_scale"] = scale
            planes.append(Plane(name, values, _PLANE))
        bands, tops = _square_root_coded(np.moveaxis(image["reflectance"].values, -1, 0))
        header["tops"] = tops
        planes.append(Plane("bands", bands, ("band", *_PLANE)))
        rgb = live_color.render(picture.image)
        if rgb is not None:
            planes.append(Plane("colours", rgb, (*_PLANE, "rgb")))
        quality = image["quality"].values.astype("<u2", copy=False)
        planes.append(Plane("quality", quality, _PLANE))
    return encode_message({**header, "coding": "display"}, planes)


def _quantised(values: NDArray[np.floating]) -> tuple[NDArray[np.uint16], float]:
    """16-bit numbers and their unit; unknown pixels are `UNKNOWN`."""
    known = np.isfinite(values)
    top = float(values.max(where=known, initial=0.0)) if known.any() else 1.0
    scale = max(top, 1e-6) / (UNKNOWN - 1)
    steps = np.where(known, values, 0.0)
    steps /= scale
    np.rint(steps, out=steps)
    coded = np.clip(steps, 0, UNKNOWN - 1, out=steps).astype("<u2")
    coded[~known] = UNKNOWN
    return coded, scale


def _square_root_coded(cube: NDArray[np.floating]) -> tuple[NDArray[np.uint8], list[float]]:
    """Each band on a square-root scale, shape (band, row, col), and the top of each scale."""
    # `fmax` takes 0 for NaN and for what is below; infinity does not occur but must not pass
    shares = np.fmax(cube, 0.0)
    shares[shares == np.inf] = 0.0
    some = shares.reshape(len(shares), -1)[:, :: sampling_step(shares[0].size)]
    index = int(some.shape[1] * _TOP_PERCENT / 100)
    tops = np.maximum(np.partition(some, index, axis=1)[:, index], 1e-9)
    shares *= (255**2 / tops)[:, None, None]
    np.sqrt(shares, out=shares)
    shares += 0.5
    coded = np.minimum(shares, 255.0, out=shares).astype(np.uint8)
    return coded, tops.tolist()
