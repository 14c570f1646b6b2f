# SPDX-License-Identifier: Apache-2.0
"""Exact numbers of one pixel of a picture: histogram, time windows, spectrum and depth."""

from __future__ import annotations

from typing import Any

import numpy as np

from hueflight.calibration import Calibration
from hueflight.daemon.materials import PictureMaterials
from hueflight.daemon.picture import Picture
from hueflight.errors import HueflightError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.reconstruction.quality import Quality

NO_COUNTS = "no histogram: the picture was made of sums, or is a file of images"


class PixelError(HueflightError):
    """There is no such pixel, or no picture yet."""


def inspect(
    picture: Picture | None,
    instrument: Instrument,
    calibration: Calibration | None,
    *,
    row: int,
    col: int,
    materials: PictureMaterials | None = None,
) -> dict[str, Any]:
    """Return all that is known about a pixel; unknown numbers are None.

    Parameters
    ----------
    picture : Picture or None
        The newest picture.
    instrument : Instrument
        Instrument of the picture.
    calibration : Calibration or None
        Calibration in use.
    row : int
        Row of the pixel.
    col : int
        Column of the pixel.
    materials : PictureMaterials, optional
        Computes abundances and indices.

    Returns
    -------
    dict
        Numbers by name, ready for JSON.

    Raises
    ------
    PixelError
        If there is no picture or no such pixel.
    """
    if picture is None:
        raise PixelError("there is no picture yet: start a run, or wait for its first picture")
    rows, cols = picture.photons.shape
    if not (0 <= row < rows and 0 <= col < cols):
        raise PixelError(f"pixel ({row}, {col}) is outside the picture of {rows} × {cols}")
    bins = calibration.bins if calibration is not None else instrument.time_bins()
    histogram = picture.histogram  # empty if only the image is known
    counts = bins.in_time_order(histogram[row, col]) if histogram.size else histogram
    found: dict[str, Any] = {
        "row": row,
        "col": col,
        "picture": picture.number,
        "frames": int(picture.frames_by_pixel[row, col]),
        "photons": int(picture.photons[row, col]),
        "edges_ns": [round(float(edge), 4) for edge in bins.edges_ns],
        "counts": counts.tolist(),
        "counts_missing": "" if histogram.size else NO_COUNTS,
        "depth_m": None,
        "depth_std_m": None,
        "background": None,
        "quality": [],
        "bands": [],
        "windows": [],
        "materials": [],
    }
    image = picture.image
    if image is None:
        return found
    flags = int(image["quality"].values[row, col])
    background = image.get("background", image["depth"] * np.nan)
    depth = _number(image["depth"].values[row, col])
    found |= {
        "depth_m": depth,
        "depth_std_m": _number(image["depth_std"].values[row, col]),
        "background": _number(background.values[row, col]),
        "quality": [(flag.name or "").lower() for flag in Quality if flags & int(flag)],
        "bands": [
            {
                "reflectance": _number(image["reflectance"].values[row, col, band]),
                "reflectance_std": _number(image["reflectance_std"].values[row, col, band]),
            }
            for band in range(len(instrument.bands))
        ],
        "windows": [] if calibration is None else _windows(calibration, row, col, depth),
        "materials": (
            []
            if materials is None
            else materials.of(image.isel(row=slice(row, row + 1), col=slice(col, col + 1)))
        ),
    }
    return found


def _windows(
    calibration: Calibration, row: int, col: int, depth: float | None
) -> list[dict[str, Any]]:
    """Time window of each band's pulse in this pixel, in nanoseconds within the period."""
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
