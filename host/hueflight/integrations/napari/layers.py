# SPDX-License-Identifier: Apache-2.0
"""Layers of napari from images: depth, colours, bands with their colours, points.

A layer is a tuple of data, settings and type, as napari defines it; making one needs no napari.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.color import color_picture
from hueflight.color.display import wavelength_colour
from hueflight.errors import HueflightError
from hueflight.export.points import image_points
from hueflight.files.bands import band_names
from hueflight.files.image_schema import SERIES_DIM, captures, instrument_of
from hueflight.model.instrument import Instrument

Layer = tuple[NDArray[Any], dict[str, Any], str]
PERCENT = (2.0, 98.0)  #: of the known values, at both ends of a colour scale


def image_layers(
    image: xr.Dataset, /, *, color: NDArray[np.uint8] | None = None, points: bool = True
) -> list[Layer]:
    """Return the layers of an image or series.

    Depth and colours are shown; bands, deviations, flags and points can be switched on. Bands are
    drawn in the colour of their wavelength and add up. Rows and columns are scaled to the shape of
    the pixels.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series that describes its instrument, or a live picture.
    color : ndarray of uint8, shape (row, col, 3), optional
        Colours of a single image; by default those of `hueflight.color.color_picture`.
    points : bool
        Whether there is a layer of points, for a single image with depths.

    Returns
    -------
    list of tuple
        Data, settings and type of each layer.
    """
    instrument = instrument_of(image, None)
    scale = pixel_scale(instrument)
    found: list[Layer] = []
    for key, variable in image.data_vars.items():
        name = str(key)
        if "band" in variable.dims:
            found += _bands(image, name, scale)
        else:
            ordered = variable.transpose(..., "row", "col").values
            unit = variable.attrs.get("units", "1")
            found.append(plane_layer(ordered, name, unit=unit, scale=scale))
    if "reflectance" in image:
        rgb = _colors(image, instrument) if color is None else color
        settings = {"name": "color", "rgb": True, "scale": _lead(scale, rgb.ndim - 3)}
        found.append((rgb, settings, "image"))
    if points and "depth" in image and SERIES_DIM not in image.dims:
        found += _points(image, instrument)
    return found


def plane_layer(
    values: NDArray[Any], name: str, /, *, unit: str, scale: tuple[float, float]
) -> Layer:
    """Return the layer of one plane, which is shown if it is the depth or the only one.

    Parameters
    ----------
    values : ndarray, shape (..., row, col)
        The values.
    name : str
        Name of the layer.
    unit : str
        Unit of the values.
    scale : tuple of float
        Height and width of a pixel.

    Returns
    -------
    tuple
        The layer.
    """
    settings = {
        "name": name,
        "scale": _lead(scale, values.ndim - 2),
        "colormap": "turbo" if name == "depth" else "gray",
        "contrast_limits": contrast_limits(values),
        "visible": name in ("depth", "photons"),
        "metadata": {"unit": unit},
    }
    return values, settings, "image"


def band_layer(
    values: NDArray[Any],
    name: str,
    rgb: tuple[float, float, float],
    /,
    *,
    scale: tuple[float, float],
) -> Layer:
    """Return the layer of one band, in its colour and hidden.

    Parameters
    ----------
    values : ndarray, shape (..., row, col)
        The values.
    name : str
        Name of the layer.
    rgb : tuple of float
        Colour of the largest values, from 0 to 1.
    scale : tuple of float
        Height and width of a pixel.

    Returns
    -------
    tuple
        The layer.
    """
    settings = {
        "name": name,
        "scale": _lead(scale, values.ndim - 2),
        "colormap": {"name": name, "colors": [[0.0, 0.0, 0.0, 1.0], [*rgb, 1.0]]},
        "blending": "additive",
        "contrast_limits": (0.0, contrast_limits(values)[1]),
        "visible": False,
    }
    return values, settings, "image"


def contrast_limits(values: NDArray[Any], /) -> tuple[float, float]:
    """Return the range of a colour scale: `PERCENT` of the known values.

    Parameters
    ----------
    values : ndarray
        The values.

    Returns
    -------
    tuple of float
        Both ends, which differ; 0 and 1 if no value is known.
    """
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, PERCENT)
    return float(low), float(high if high > low else low + 1)


def pixel_scale(instrument: Instrument, /) -> tuple[float, float]:
    """Return height and width of a pixel in micrometres, or 1 and 1 if the sensor states none.

    Parameters
    ----------
    instrument : Instrument
        The instrument.

    Returns
    -------
    tuple of float
        Height and width.
    """
    sensor = instrument.sensor
    return sensor.pixel_height_um or 1.0, sensor.pixel_width_um or 1.0


def _bands(image: xr.Dataset, name: str, scale: tuple[float, float]) -> list[Layer]:
    cube = image[name].transpose("band", ..., "row", "col").values
    labels = zip(band_names(image), image["wavelength"].values, cube, strict=True)
    return [
        band_layer(plane, f"{name} {band} {nm:g} nm", wavelength_colour(float(nm)), scale=scale)
        for band, nm, plane in labels
    ]


def _colors(image: xr.Dataset, instrument: Instrument) -> NDArray[np.uint8]:
    def rendered(single: xr.Dataset) -> NDArray[np.uint8]:
        try:
            return np.rint(color_picture(single, instrument=instrument) * 255).astype(np.uint8)
        except HueflightError:  # no pixel is known
            return np.zeros((*instrument.image_shape, 3), np.uint8)

    if SERIES_DIM not in image.dims:
        return rendered(image)
    return np.stack([rendered(single) for single in captures(image)])


def _points(image: xr.Dataset, instrument: Instrument) -> list[Layer]:
    if not np.isfinite(image["depth"].values).any():
        return []
    cloud = image_points(image, instrument=instrument)
    settings = {
        "name": "points",
        "features": dict(cloud.fields),
        "face_color": cloud.rgb / 255,
        "border_width": 0.0,
        "size": float(np.median(cloud.xyz[:, 2])) / 100,  # metres
        "visible": False,
    }
    # napari's axes are depth, down, right
    return [(cloud.xyz[:, ::-1], settings, "points")]


def _lead(scale: tuple[float, float], count: int) -> tuple[float, ...]:
    """The scale with further axes in front."""
    return (1.0,) * count + scale
