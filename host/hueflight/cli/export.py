# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hueflight.analysis import flatten, illumination_pattern
from hueflight.cli.output import print_notice, show
from hueflight.export import FORMATS, write
from hueflight.files.bands import find_band
from hueflight.files.image_schema import instrument_of
from hueflight.importers import read_image

_ENDINGS = ", ".join(f"{entry.endings[0]} ({entry.summary})" for entry in FORMATS.values())


def export(
    image: Path,
    out: Annotated[
        Path,
        Parameter(help=f"File or folder to write. Its extension selects the format: {_ENDINGS}."),
    ],
    *,
    format: Annotated[  # noqa: A002
        str | None,
        Parameter(
            name=["--format", "-f"],
            help=f"Name of the format, whatever the extension of the file: {', '.join(FORMATS)}. "
            "By default the extension selects it.",
        ),
    ] = None,
    variable: str | None = None,
    band: str | None = None,
    limits: Annotated[tuple[float, float] | None, Parameter(negative_iterable=())] = None,
    flat_field: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write an image in a format that other tools open.

    Parameters
    ----------
    image : Path
        Image that `hueflight reconstruct` wrote (.zarr), or one that was exported to NetCDF (.nc).
    out : Path
        File or folder to write.
    format : str, optional
        Name of the format.
    variable : str, optional
        What a .png shows: depth, depth_std, reflectance, reflectance_std, background, photons or
        quality; rgb for colours, or three-band for the false colours of the paper. By default
        depth.
    band : str, optional
        Band to draw as .png, for a variable that has bands: its name, its number (from 0), or a
        wavelength such as 532nm, which finds the nearest band.
    limits : tuple of float, optional
        Values at the ends of the colour scale of a .png: two numbers, such as 0.3 1.5. By default
        they follow from the values.
    flat_field : Path, optional
        Image of a flat, matte board of one color that fills the picture, made with the same
        calibration. Reflectances are divided by the pattern of each band's light that it shows.
    overwrite : bool, default False
        Replace existing files of that name.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    loaded = read_image(image)
    if flat_field is not None:
        loaded = flatten(loaded, illumination_pattern(read_image(flat_field)))
    options: dict[str, Any] = {"variable": variable, "limits": limits}
    if band is not None:
        options["band"] = find_band(loaded, band)
    options = {name: value for name, value in options.items() if value is not None}
    written = write(loaded, out, format=format, overwrite=overwrite, **options)
    cloud = format in ("ply", "las") or out.suffix.lower() in (".ply", ".las")
    described = "instrument_description" in loaded.attrs
    if cloud and described and instrument_of(loaded).lens is None:
        print_notice(
            "the instrument has no lens, so that the points lie on a line along the optical axis: "
            "state the lens and the pixel pitch in its description and calibrate again"
        )
    show(f"Export of {image}", {"files": [str(path) for path in written]}, json_wanted=json)
