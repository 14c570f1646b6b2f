"""One pixel of a picture, in numbers: its histogram, windows, spectrum and depth."""

from __future__ import annotations

from typing import Any

import numpy as np

from hueflight.calibration import Calibration
from hueflight.daemon.pictures import Picture
from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.reconstruction.quality import Quality


class PixelError(HueflightError):
    """A pixel that is not in the picture, or no picture yet."""


def inspect(
    picture: Picture | None,
    instrument: Instrument,
    calibration: Calibration | None,
    *,
    row: int,
    col: int,
) -> dict[str, Any]:
    """Everything known of a pixel; what is not known is None.

    Parameters
    ----------
    picture : the newest one.
    row, col : of the pixel.

    Raises
    ------
    PixelError
        If there is no picture or no such pixel.
    """
    if picture is None:
        raise PixelError("there is no picture yet: start a run")
    rows, cols = picture.photons.shape
    if not (0 <= row < rows and 0 <= col < cols):
        raise PixelError(f"pixel ({row}, {col}) is outside the picture of {rows} × {cols}")
    bins = calibration.bins if calibration is not None else instrument.time_bins()
    light = bins.in_time_order(picture.counts[row, col])
    found: dict[str, Any] = {
        "row": row,
        "col": col,
        "picture": picture.number,
        "frames": picture.frames,
        "photons": int(picture.photons[row, col]),
        "edges_ns": [round(float(edge), 4) for edge in bins.edges_ns],
        "counts": light.tolist(),
        "depth_m": None,
        "depth_std_m": None,
        "background": None,
        "quality": [],
        "bands": [],
        "windows": [],
    }
    image = picture.image
    if image is None or calibration is None:
        return found
    flags = int(image["quality"].values[row, col])
    depth = _number(image["depth"].values[row, col])
    found |= {
        "depth_m": depth,
        "depth_std_m": _number(image["depth_std"].values[row, col]),
        "background": _number(image["background"].values[row, col]),
        "quality": [(flag.name or "").lower() for flag in Quality if flags & int(flag)],
        "bands": [
            {
                "reflectance": _number(image["reflectance"].values[row, col, band]),
                "reflectance_std": _number(image["reflectance_std"].values[row, col, band]),
            }
            for band in range(len(instrument.bands))
        ],
        "windows": _windows(calibration, row, col, depth),
    }
    return found


def _windows(
    calibration: Calibration, row: int, col: int, depth: float | None
) -> list[dict[str, Any]]:
    """Where each band's pulse falls in this pixel, nanoseconds within the period."""
    if depth is None:
        return []
    bins = calibration.bins
    cosine = float(calibration.instrument.ray_cosine()[row, col])
    shift_ns = 2 * (depth - calibration.distance) / cosine / SPEED_OF_LIGHT_M_PER_NS
    shift_ns += float(calibration.pixel_delay_ns[row, col])
    width_ns = bins.span_ns / bins.count
    return [
        {
            "band": window.band,
            "start_ns": float(bins.edges_ns[0]) + window.start * width_ns + shift_ns,
            "stop_ns": float(bins.edges_ns[0]) + window.stop * width_ns + shift_ns,
        }
        for window in calibration.windows
    ]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
