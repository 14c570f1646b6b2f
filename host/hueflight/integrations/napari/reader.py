# SPDX-License-Identifier: Apache-2.0
"""The reader of the napari plugin: images, OME-TIFF that we exported, and recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.export.description import describe
from hueflight.export.ome import NAMESPACE
from hueflight.files.optional import import_optional
from hueflight.importers.images import is_image, read_image
from hueflight.integrations.napari.layers import (
    Layer,
    band_layer,
    image_layers,
    pixel_scale,
    plane_layer,
)
from hueflight.model.instrument import Instrument
from hueflight.reconstruction import reconstruct
from hueflight.recording import open_recording

CALIBRATION = "calibration.zarr"  #: beside a recording: its image is reconstructed
Reader = Callable[[str | Sequence[str]], list[Layer]]
_OME_ENDINGS = (".ome.tif", ".ome.tiff")
_OME = f"{{{NAMESPACE}}}"


def reader_of(path: str | Sequence[str]) -> Reader | None:
    """Return the function that reads a file, as napari asks for it.

    Parameters
    ----------
    path : str or sequence of str
        Path of the file, or of several.

    Returns
    -------
    callable or None
        Returns the layers of the files; None if one of them is none of ours.
    """
    paths = [path] if isinstance(path, str) else list(path)
    if not all(_reader(Path(each)) for each in paths):
        return None
    return read


def read(path: str | Sequence[str]) -> list[Layer]:
    """Return the layers of files.

    Parameters
    ----------
    path : str or sequence of str
        Path of a file, or of several.

    Returns
    -------
    list of tuple
        Data, settings and type of each layer.

    Raises
    ------
    HueflightError
        If a file is damaged, or is none of ours.
    """
    found: list[Layer] = []
    for each in [path] if isinstance(path, str) else path:
        reader = _reader(Path(each))
        if reader is None:
            raise HueflightError(f"{each!r} is no image and no recording of Hueflight")
        found += reader(Path(each))
    return found


def _reader(path: Path) -> Callable[[Path], list[Layer]] | None:
    name = path.name.lower()
    if name.endswith(".mcap"):
        return recording_layers
    if name.endswith(_OME_ENDINGS):
        return ome_layers if _ome_description(path) is not None else None
    return _stored_layers if is_image(path) else None


def _stored_layers(path: Path) -> list[Layer]:
    return image_layers(read_image(path))


def recording_layers(path: Path, /) -> list[Layer]:
    """Return the layers of a recording.

    Parameters
    ----------
    path : pathlib.Path
        The recording. If a ``calibration.zarr`` lies beside it, the image is reconstructed.

    Returns
    -------
    list of tuple
        Photons of each pixel, counts of each code (code, row, col), and the layers of the image.

    Raises
    ------
    HueflightError
        If the recording is damaged, or the calibration is of another instrument.
    """
    with open_recording(path) as recording:
        histogram = recording.histogram()
        instrument = recording.instrument
    scale = pixel_scale(instrument)
    first = 1 if instrument.sensor.reports_empty else 0
    photons = histogram[..., first:].sum(axis=-1)
    counts = np.moveaxis(histogram, -1, 0)
    found = []
    calibration = path.with_name(CALIBRATION)
    if calibration.exists():
        used = Calibration.load(calibration)
        image = describe(reconstruct(histogram, used), used)
        found = image_layers(image.drop_vars("photons"))
    shown = plane_layer(photons, "photons", unit="count", scale=scale)
    cube = plane_layer(counts, "counts", unit="count", scale=scale)
    shown[1]["visible"] = not found
    return [shown, cube, *found]


def ome_layers(path: Path, /) -> list[Layer]:
    """Return the layers of an OME-TIFF that `hueflight.export.write_ome_tiff` wrote.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Returns
    -------
    list of tuple
        A layer for each channel, with the name and colour that the file states.

    Raises
    ------
    HueflightError
        If the file is not ours.
    """
    tifffile = import_optional("tifffile", extra="export")
    root = _ome_description(path)
    if root is None:
        raise HueflightError(f"{path}: no OME-TIFF that Hueflight wrote")
    entries = {entry.get("K"): entry.text or "" for entry in root.iter(f"{_OME}M")}
    scale = (1.0, 1.0)
    if "instrument_description" in entries:
        described = Instrument.from_json(entries["instrument_description"], where=str(path))
        scale = pixel_scale(described)
    found: list[Layer] = []
    with tifffile.TiffFile(path) as file:
        for image, series in zip(root.iter(f"{_OME}Image"), file.series, strict=True):
            channels = list(image.iter(f"{_OME}Channel"))
            pages = np.stack([page.asarray() for page in series.pages])
            cube = pages.reshape(-1, len(channels), *pages.shape[-2:]).swapaxes(0, 1)
            for channel, values in zip(channels, cube, strict=True):
                single = values[0] if len(values) == 1 else values
                found.append(_channel(image.get("Name", ""), channel, single, scale))
    return found


def _channel(
    image: str, channel: Xml.Element, values: np.ndarray, scale: tuple[float, float]
) -> Layer:
    name = channel.get("Name", "")
    if color := channel.get("Color"):
        packed = int(color) % 2**32
        red, green, blue = (packed >> shift & 255 for shift in (24, 16, 8))
        rgb = (red / 255, green / 255, blue / 255)
        return band_layer(values, f"{image} {name}", rgb, scale=scale)
    plane, _, unit = name.partition(" [")
    return plane_layer(values, plane, unit=unit.rstrip("]"), scale=scale)


def _ome_description(path: Path) -> Xml.Element | None:
    """The OME-XML of a file that we wrote; None for any other."""
    tifffile = import_optional("tifffile", extra="export")
    try:
        with tifffile.TiffFile(path) as file:
            text = file.ome_metadata
    except (OSError, tifffile.TiffFileError):
        return None
    if not text:
        return None
    root = Xml.fromstring(text)
    ours = root.findall(f".//{_OME}MapAnnotation[@Namespace='hueflight']")
    return root if ours else None
