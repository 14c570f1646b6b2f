# SPDX-License-Identifier: Apache-2.0
"""OME-TIFF: bands as channels with their wavelengths, for microscopy software.

This follows the OME data model, schema 2016-06 (https://www.openmicroscopy.org/Schemas/OME/
2016-06): one Image each for reflectance and its uncertainty (a channel per band), one for the
other floating-point planes, one for the quality flags. A pixel seen through a lens has no physical
size, which grows with the distance of what it sees, and OME has no angles among its units: the
annotation has the angles instead.
"""

from __future__ import annotations

from colorsys import hsv_to_rgb
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.export.description import plain_attributes
from hueflight.export.tiff import CLASSIC_LIMIT, storable
from hueflight.files import import_optional, staged
from hueflight.files.bands import band_names
from hueflight.files.image_schema import SERIES_DIM, captures, instrument_of, require_image
from hueflight.model.instrument import Instrument

VISIBLE_NM = (400.0, 660.0)  #: from violet to red, for the colors of channels
NAMESPACE = "http://www.openmicroscopy.org/Schemas/OME/2016-06"
PIXEL_TYPES = {"float32": "float", "int32": "int32", "uint32": "uint32", "int16": "int16",
               "uint16": "uint16", "uint8": "uint8"}  # fmt: skip


def write_ome_tiff(image: xr.Dataset, path: str | Path, /, *, overwrite: bool = False) -> None:
    """Write an image or series as an OME-TIFF; the captures of a series are its time points.

    Parameters
    ----------
    image : xarray.Dataset
        Image or series.
    path : str or pathlib.Path
        Name of the file.
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
    require_image(image)
    tifffile = import_optional("tifffile", extra="export")
    stacks = _stacks(image)
    big = sum(stack.nbytes for _, stack, _ in stacks) > CLASSIC_LIMIT
    xml = _description(image, stacks)
    with (
        staged(path, overwrite=overwrite) as partial,
        tifffile.TiffWriter(partial, bigtiff=big, byteorder="<") as writer,
    ):
        for _, stack, _ in stacks:
            for plane in stack.reshape(-1, *stack.shape[2:]):
                writer.write(
                    plane,
                    photometric="minisblack",
                    metadata=None,
                    description=xml,  # belongs to the first page only
                    software=image.attrs.get("software", "hueflight"),
                )
                xml = None


def _stacks(image: xr.Dataset) -> list[tuple[str, NDArray[Any], list[dict[str, str]]]]:
    """Return name, values (time, channel, row, col) and channel attributes of each OME Image."""
    series = image if SERIES_DIM in image.dims else image.expand_dims(SERIES_DIM)
    names, wavelengths = band_names(image), image["wavelength"].values
    spectral = [
        {
            "Name": f"{name} {wavelength:g} nm",
            "EmissionWavelength": repr(float(wavelength)),
            "EmissionWavelengthUnit": "nm",
            "ExcitationWavelength": repr(float(wavelength)),
            "ExcitationWavelengthUnit": "nm",
            "Color": str(_color(float(wavelength))),
        }
        for name, wavelength in zip(names, wavelengths, strict=True)
    ]
    cubes: list[tuple[str, NDArray[Any], list[dict[str, str]]]] = []
    planes: dict[str, list[tuple[str, NDArray[Any]]]] = {}
    for key, variable in series.data_vars.items():
        name = str(key)
        if "band" in variable.dims:
            ordered = variable.transpose(SERIES_DIM, "band", "row", "col").values
            cubes.append((name, storable(ordered, name), spectral))
        else:
            plane = storable(variable.transpose(SERIES_DIM, "row", "col").values, name)
            planes.setdefault(plane.dtype.name, []).append((name, plane))
    for members in planes.values():
        label = members[0][0] if len(members) == 1 else "planes"
        channels = [
            {"Name": f"{name} [{series[name].attrs.get('units', '1')}]"} for name, _ in members
        ]
        cubes.append((label, np.stack([plane for _, plane in members], axis=1), channels))
    return cubes


def _color(wavelength_nm: float) -> int:
    """Color of a channel as OME has it: red, green, blue and opacity in a signed 32-bit number."""
    red, green, blue = 255, 255, 255  # outside the visible range
    if VISIBLE_NM[0] <= wavelength_nm <= VISIBLE_NM[1]:
        hue = 0.78 * (VISIBLE_NM[1] - wavelength_nm) / (VISIBLE_NM[1] - VISIBLE_NM[0])
        red, green, blue = (round(255 * part) for part in hsv_to_rgb(hue, 1, 1))
    packed = red << 24 | green << 16 | blue << 8 | 255
    return packed - 2**32 if packed >= 2**31 else packed


def _description(
    image: xr.Dataset, stacks: list[tuple[str, NDArray[Any], list[dict[str, str]]]]
) -> str:
    """Return the OME-XML block."""
    root = Xml.Element("OME", {"xmlns": NAMESPACE, "Creator": image.attrs.get("software", "")})
    page = 0
    for number, (name, stack, channels) in enumerate(stacks):
        times, count, rows, cols = stack.shape
        entry = Xml.SubElement(root, "Image", {"ID": f"Image:{number}", "Name": name})
        pixels = Xml.SubElement(
            entry,
            "Pixels",
            {
                "ID": f"Pixels:{number}",
                "DimensionOrder": "XYCZT",
                "Type": PIXEL_TYPES[stack.dtype.name],
                "BigEndian": "false",
                "SizeX": str(cols),
                "SizeY": str(rows),
                "SizeC": str(count),
                "SizeZ": "1",
                "SizeT": str(times),
            },
        )
        for index, channel in enumerate(channels):
            Xml.SubElement(
                pixels,
                "Channel",
                {"ID": f"Channel:{number}:{index}", "SamplesPerPixel": "1", **channel},
            )
        for time in range(times):
            for index in range(count):
                Xml.SubElement(
                    pixels,
                    "TiffData",
                    {
                        "IFD": str(page),
                        "PlaneCount": "1",
                        "FirstC": str(index),
                        "FirstZ": "0",
                        "FirstT": str(time),
                    },
                )
                page += 1
        Xml.SubElement(entry, "AnnotationRef", {"ID": "Annotation:0"})
    annotations = Xml.SubElement(root, "StructuredAnnotations")
    mapping = Xml.SubElement(
        annotations, "MapAnnotation", {"ID": "Annotation:0", "Namespace": "hueflight"}
    )
    values = Xml.SubElement(mapping, "Value")
    for key, value in _origin(image).items():
        Xml.SubElement(values, "M", {"K": key}).text = value
    # character references keep the block in ASCII, as the TIFF tag requires
    return Xml.tostring(root, encoding="us-ascii", xml_declaration=True).decode()


def _origin(image: xr.Dataset) -> dict[str, str]:
    single = captures(image)[0]
    known = plain_attributes(single)
    if "instrument_description" in image.attrs:
        known["instrument_description"] = image.attrs["instrument_description"]
        known |= _angles(image, instrument_of(image))
    return known


def _angles(image: xr.Dataset, instrument: Instrument) -> dict[str, str]:
    """Angles in degrees of a pixel on the axis of the lens, and of the image if it is whole."""
    sizes = {"pixel_angle": (1, 1)}
    if (image.sizes["row"], image.sizes["col"]) == instrument.image_shape:
        sizes["field_of_view"] = instrument.image_shape
    known: dict[str, str] = {}
    for name, pixels in sizes.items():
        if (angles := instrument.viewing_angles_deg(pixels)) is not None:
            known |= {f"{name}_x_deg": f"{angles[0]:.6g}", f"{name}_y_deg": f"{angles[1]:.6g}"}
    return known
