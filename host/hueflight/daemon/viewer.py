# SPDX-License-Identifier: Apache-2.0
"""An image or a histogram as one HTML file that any browser shows without a server.

The page shows what the live page shows, with the same plots: depth, colour, bands, photons, points
and the histogram of a pixel, and in addition uncertainty, quality and the fit drawn through the
histogram. Everything is inside the file, compressed.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from contextlib import suppress
from html import escape
from importlib import resources
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.calibration import Calibration
from hueflight.color import color_picture
from hueflight.daemon.page_files import page_files
from hueflight.errors import HueflightError
from hueflight.files.image_schema import SERIES_DIM, require_image
from hueflight.model.histograms import check_histogram
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS, Instrument
from hueflight.model.time_bins import TimeBins
from hueflight.reconstruction.quality import Quality

#: modules of the live page that the viewer shares with it, in the order of their dependence
MODULES = ("colormap.js", "colours.js", "values.js", "gl.js", "plots.js")
LARGEST = 128 * 2**20  #: counts in a page; more would be slow to load
TEMPLATE_STEPS = 4096  #: of the table of a band's waveform
LABELS = {
    "depth": "Depth", "colour": "Color", "depth_std": "Uncertainty", "quality": "Quality",
    "points": "Points", "photons": "Photons", "background": "Background",
}  # fmt: skip
UNITS = {"depth": "m", "depth_std": "m", "photons": "photons", "background": "per code"}


def viewer_page(
    *,
    title: str,
    instrument: Instrument,
    image: xr.Dataset | None = None,
    histogram: ArrayLike | None = None,
    calibration: Calibration | None = None,
) -> str:
    """Make the page of an image, a histogram, or both.

    Parameters
    ----------
    title : str
        Title of the page.
    instrument : Instrument
        Instrument that made them.
    image : xarray.Dataset, optional
        A single image.
    histogram : array_like, shape (row, col, code), optional
        Counts of which the image was made, or which are shown alone.
    calibration : Calibration, optional
        Calibration that the image was made with, for the fit through the histogram.

    Returns
    -------
    str
        The HTML file.

    Raises
    ------
    HueflightError
        If there is neither, the image is a series, or the histogram is too large.
    """
    if image is None and histogram is None:
        raise HueflightError("there is neither an image nor a histogram to show")
    bins = instrument.time_bins() if calibration is None else calibration.bins
    planes: dict[str, NDArray[Any]] = {}
    counts = None if histogram is None else _counts(histogram, instrument, bins)
    if image is not None:
        planes |= _image_planes(image, instrument)
    elif counts is not None:
        planes["photons"] = counts.sum(axis=-1).astype(np.float32)
    model = None
    if counts is not None:
        planes["counts"] = counts
        if image is not None and calibration is not None and "white_photons" in image.coords:
            planes |= _model_planes(image, calibration)
            model = _model(image, calibration)
    packed, listed = _packed(planes)
    views = [name for name in LABELS if name in planes or (name == "points" and image is not None)]
    names = _names(image, instrument)
    rows, cols = planes["photons" if image is None else "depth"].shape
    shown = [[name, LABELS[name]] for name in views]
    if "reflectance" in planes:
        shown[2:2] = [[f"band {number}", name] for number, (name, _) in enumerate(names)]
    meta = {
        "title": title,
        "rows": rows,
        "cols": cols,
        "aspect": (instrument.sensor.pixel_height_um or 1)
        / (instrument.sensor.pixel_width_um or 1),
        "bands": [{"name": name, "wavelength_nm": nm} for name, nm in names],
        "views": shown,
        "units": UNITS,
        "about": _about(image, instrument),
        "flags": {int(flag): (flag.name or "").lower() for flag in Quality},
        "planes": listed,
        "facts": _facts(image, instrument),
        "edges_ns": None if counts is None else np.round(bins.edges_ns, 4).tolist(),
        "model": model,
        "pixel": _brightest(planes),
    }
    return _filled(meta, packed)


def _counts(histogram: ArrayLike, instrument: Instrument, bins: TimeBins) -> NDArray[Any]:
    counts = bins.in_time_order(check_histogram(histogram, instrument))
    if counts.size > LARGEST:
        raise HueflightError(
            f"the histogram has {counts.size / 2**20:.0f} million counts, a page holds at most "
            f"{LARGEST / 2**20:.0f} million: cut out a region, or show the image alone"
        )
    if counts.dtype.kind == "f":
        return counts.astype(np.float32)
    return counts.astype(np.uint16 if counts.max(initial=0) < 2**16 else np.uint32)


def _image_planes(image: xr.Dataset, instrument: Instrument) -> dict[str, NDArray[Any]]:
    require_image(image)
    if SERIES_DIM in image.dims:
        raise HueflightError(f"this is a series of images: select one {SERIES_DIM!r} first")
    ordered = image.transpose("band", "row", "col")
    wanted = ("depth", "depth_std", "photons", "background", "reflectance", "reflectance_std")
    planes: dict[str, NDArray[Any]] = {
        name: ordered[name].values.astype(np.float32) for name in wanted if name in ordered
    }
    planes["quality"] = ordered["quality"].values.astype(np.uint16)
    # without visible bands, or a pixel with a reflectance, the page has no such view
    with suppress(HueflightError):
        colors = color_picture(image, instrument=instrument)
        planes["colour"] = np.rint(np.nan_to_num(colors) * 255).astype(np.uint8)
    if planes["depth"].shape == instrument.image_shape:
        right, down = instrument.ray_slopes()
        planes["right"], planes["down"] = (part.astype(np.float32) for part in (right, down))
    return planes


def _model_planes(image: xr.Dataset, calibration: Calibration) -> dict[str, NDArray[Any]]:
    depth = image["depth"].transpose("row", "col").values.astype(np.float64)
    cosine = calibration.instrument.ray_cosine()
    delay_ns = 2 * (depth - calibration.distance) / cosine / SPEED_OF_LIGHT_M_PER_NS
    white = image["white_photons"].transpose("row", "col").values
    return {
        "delay": (delay_ns + calibration.pixel_delay_ns).astype(np.float32),
        "white": white.astype(np.float32),
    }


def _model(image: xr.Dataset, calibration: Calibration) -> dict[str, Any]:
    templates = calibration.templates
    names = [band.name for band in calibration.instrument.bands]
    chosen = [names.index(str(name)) for name in image["band_name"].values]
    edges_ns = np.linspace(0, templates.circle_ns, TEMPLATE_STEPS + 1)
    tables = np.cumsum(templates.shares(edges_ns)[chosen], axis=-1)
    return {
        "circle_ns": templates.circle_ns,
        "bin_width_ns": calibration.bins.span_ns / calibration.bins.count,
        "share": image["white_share"].values.astype(float).tolist(),
        "templates": [[0.0, *np.round(table, 7).tolist()] for table in tables],
    }


def _names(image: xr.Dataset | None, instrument: Instrument) -> list[tuple[str, float]]:
    if image is None or "band_name" not in image.coords:
        return [(band.name, band.wavelength_nm) for band in instrument.bands]
    values = zip(image["band_name"].values, image["wavelength"].values, strict=True)
    return [(str(name), float(wavelength)) for name, wavelength in values]


def _about(image: xr.Dataset | None, instrument: Instrument) -> dict[str, str]:
    about = {
        "depth_std": "Standard deviation of depth.",
        "quality": "Flags of each pixel as a number; those of the chosen pixel are named.",
    }
    if instrument.lens is None:
        about["points"] = "The instrument has no lens: the points lie on a line."
    if image is not None and (text := image["reflectance"].attrs.get("long_name")):
        about |= {f"band {number}": f"{text}." for number in range(image.sizes["band"])}
    return about


def _facts(image: xr.Dataset | None, instrument: Instrument) -> dict[str, str]:
    known = {key: str(value) for key, value in instrument.facts().items() if value is not None}
    if image is not None:
        for key in ("method", "reference_distance_m", "exposures", "software", "recording"):
            if key in image.attrs:
                known[key] = str(image.attrs[key])
    return known


def _brightest(planes: dict[str, NDArray[Any]]) -> list[int]:
    """A pixel to begin with: the one with the most photons of those with a depth."""
    photons = planes.get("photons", planes.get("depth", next(iter(planes.values()))))
    weight = np.nan_to_num(photons.astype(np.float64), nan=-1.0)
    if "depth" in planes:
        weight = np.where(np.isfinite(planes["depth"]), weight, -1.0)
    row, col = np.unravel_index(int(weight.argmax()), weight.shape)
    return [int(row), int(col)]


def _packed(planes: dict[str, NDArray[Any]]) -> tuple[bytes, list[dict[str, Any]]]:
    """All planes in one compressed block, each at a multiple of 4 bytes, and where they are."""
    parts, listed, offset = [], [], 0
    for name, plane in planes.items():
        raw = np.ascontiguousarray(plane.astype(plane.dtype.newbyteorder("<"))).tobytes()
        listed.append(
            {"name": name, "type": plane.dtype.name, "offset": offset, "length": plane.size}
        )
        raw += bytes(-len(raw) % 4)
        parts.append(raw)
        offset += len(raw)
    return zlib.compress(b"".join(parts), 6), listed


def _filled(meta: dict[str, Any], packed: bytes) -> str:
    files = page_files()
    modules = []
    for name in MODULES:
        text = files[name].decode()
        text = re.sub(r"^import .*$", "", text, flags=re.MULTILINE)
        modules.append(re.sub(r"^export ", "", text, flags=re.MULTILINE))
    parts = {
        "TITLE": escape(str(meta["title"])),
        "STYLE": files["style.css"].decode(),
        # "</script>" in a name must not end the block
        "META": json.dumps(meta).replace("<", "\\u003c"),
        "DATA": base64.b64encode(packed).decode(),
        "MODULES": "\n".join(modules),
    }
    page = (resources.files("hueflight.daemon") / "viewer.html").read_text("utf-8")
    return re.sub(r"@([A-Z]+)@", lambda found: parts[found[1]], page)
