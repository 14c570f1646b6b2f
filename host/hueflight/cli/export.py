# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import xarray as xr
from cyclopts import Parameter

from hueflight.analysis import (
    SpectralLibrary,
    add_materials,
    flatten,
    illumination_pattern,
)
from hueflight.calibration import Calibration
from hueflight.cli.options import WHOLE
from hueflight.cli.output import print_notice, show
from hueflight.errors import ExportError
from hueflight.export import FORMATS, add_foxglove_channels, write
from hueflight.files.image_schema import instrument_of
from hueflight.importers import read_image
from hueflight.recording.layout import SUFFIX

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
    library: str | None = None,
    materials: str | None = None,
    index: Annotated[tuple[str, ...], Parameter(negative_iterable=())] = (),
    calibration: Annotated[Path | None, Parameter(name=["--calibration", "-c"])] = None,
    every: Annotated[int | None, WHOLE] = None,
    frames: Annotated[int | None, WHOLE] = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write an image in a format that other tools open, or pictures into a recording.

    Parameters
    ----------
    image : Path
        Image that `hueflight reconstruct` wrote (.zarr), or one that was exported to NetCDF (.nc).
        Of a recording (.mcap), a copy (.mcap) is written that has the same packets, byte for byte,
        and channels of pictures for Foxglove.
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
    library : str, optional
        Spectra of materials, whose abundances are added: a CSV file with a column of wavelengths in
        nm and one of reflectances for each material, or colorchecker.
    materials : str, optional
        Names of the materials of the library, separated by commas; by default all. There may be at
        most as many as there are bands.
    index : tuple of str, optional
        Spectral index to add: NDVI, NGRDI, PRI, or two bands such as 525nm,659nm for their
        normalized difference. May be given several times.
    calibration : Path, optional
        Calibration with which the pictures of a recording are reconstructed.
    every : int, optional
        Frames of a recording from one picture to the next. By default as many as are behind each.
    frames : int, optional
        Frames of a recording behind each picture. By default 480.
    overwrite : bool, default False
        Replace existing files of that name.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    if library is None:
        _refuse("without --library", materials=materials)
    chosen = None if library is None else _materials(library, materials)

    def enriched(plain: xr.Dataset) -> xr.Dataset:
        return add_materials(plain, library=chosen, indices=index)

    if image.suffix.lower() == SUFFIX:
        _refuse("of a recording", variable=variable, band=band, limits=limits,
                flat_field=flat_field, format=format)  # fmt: skip
        _export_recording(
            image, out, calibration, enriched, every=every, frames=frames, overwrite=overwrite
        )
        show(f"Export of {image}", {"files": [str(out)]}, json_wanted=json)
        return
    _refuse("of an image", calibration=calibration, every=every, frames=frames)
    loaded = read_image(image)
    if flat_field is not None:
        loaded = flatten(loaded, illumination_pattern(read_image(flat_field)))
    loaded = enriched(loaded)
    options: dict[str, Any] = {"variable": variable, "band": band, "limits": limits}
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


def _refuse(where: str, **options: object) -> None:
    """Refuse options that would have no effect."""
    for name, value in options.items():
        if value is not None:
            flag = "--" + name.replace("_", "-")
            raise ExportError(f"{flag} {value}: has no effect on the export {where}")


def _materials(library: str, materials: str | None) -> SpectralLibrary:
    read = SpectralLibrary.named(library)
    if materials is None:
        return read
    return read.select([name.strip() for name in materials.split(",")])


def _export_recording(
    recording: Path,
    out: Path,
    calibration: Path | None,
    enriched: Callable[[xr.Dataset], xr.Dataset],
    *,
    every: int | None,
    frames: int | None,
    overwrite: bool,
) -> None:
    """Write a recording with channels of pictures."""
    if out.suffix.lower() != SUFFIX:
        raise ExportError(
            f"{str(recording)!r} is a recording, which is exported to {SUFFIX}, not to "
            f"{out.name!r}: for other formats reconstruct it first"
        )
    if calibration is None:
        raise ExportError(
            f"pictures of the recording {str(recording)!r} need its calibration: --calibration "
            "calibration.zarr"
        )
    numbers = {"frames": frames} if frames is not None else {}
    add_foxglove_channels(
        recording,
        out,
        Calibration.load(calibration),
        every=every,
        enrich=enriched,
        overwrite=overwrite,
        **numbers,
    )
