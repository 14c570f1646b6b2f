# SPDX-License-Identifier: Apache-2.0
"""Registry of the formats for images, and the function that writes any of them.

A format is one more entry of `FORMATS`, or, in another package, an entry point in the group
`hueflight.exporters` that refers to a `Format` and has the name of the format::

    [project.entry-points."hueflight.exporters"]
    xyz = "my_package:XYZ"
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from inspect import signature
from pathlib import Path
from typing import Any

import xarray as xr

from hueflight.arguments import PATH, SWITCH, TEXT, takes
from hueflight.errors import ExportError
from hueflight.export.envi import write_envi
from hueflight.export.foxglove import write_foxglove
from hueflight.export.las import write_las
from hueflight.export.ome import write_ome_tiff
from hueflight.export.ply import write_ply
from hueflight.export.preview import write_depth_png, write_png, write_previews
from hueflight.export.stores import write_netcdf, write_zarr
from hueflight.export.tables import write_csv
from hueflight.export.tiff import write_tiff
from hueflight.files.atomic import NOTHING_LEFT
from hueflight.files.image_schema import captures, require_image
from hueflight.memory import within_memory

ENTRY_POINT_GROUP = "hueflight.exporters"


@dataclass(frozen=True)
class Format:
    """A format for images.

    Attributes
    ----------
    name : str
        Name by which it is selected.
    endings : tuple of str
        File extensions that select it, in lower case, the usual one first.
    write : callable
        Function ``write(image, path, overwrite=…, …)``; its further keyword-only parameters are
        the options of the format.
    series : bool
        Whether one file can hold a whole series.
    summary : str
        What the format is used for.
    """

    name: str
    endings: tuple[str, ...]
    write: Callable[..., None]
    series: bool
    summary: str


FORMATS = {
    entry.name: entry
    for entry in (
        Format("zarr", (".zarr",), write_zarr, True, "everything, for xarray and the cloud"),
        Format("netcdf", (".nc", ".nc4"), write_netcdf, True, "everything in one file"),
        Format("ome-tiff", (".ome.tif", ".ome.tiff"), write_ome_tiff, True, "microscopy software"),
        Format("tiff", (".tif", ".tiff"), write_tiff, True, "one page per plane, for any reader"),
        Format("envi", (".hdr",), write_envi, False, "imaging spectroscopy"),
        Format("ply", (".ply",), write_ply, False, "point cloud for 3-D software"),
        Format("las", (".las",), write_las, False, "point cloud for lidar software"),
        Format("foxglove", (".mcap",), write_foxglove, True, "Foxglove and robotics software"),
        Format("depth-png", (".depth.png",), write_depth_png, False, "16-bit depth in millimetres"),
        Format("png", (".png",), write_png, False, "one plane with its colour bar"),
        Format("previews", (".previews",), write_previews, False, "a folder of all pictures"),
        Format("csv", (".csv",), write_csv, True, "spectra of regions"),
    )
}


def all_formats() -> dict[str, Format]:
    """Return the formats of this package and of installed ones by name."""
    installed = entry_points(group=ENTRY_POINT_GROUP)
    return FORMATS | {entry.name: entry.load() for entry in installed if entry.name not in FORMATS}


def format_of(path: str | Path, name: str | None = None) -> Format:
    """Return the format of a name, or the one that a file extension selects.

    Parameters
    ----------
    path : str or pathlib.Path
        Name of a file.
    name : str, optional
        Name of a format, which overrides the file extension.

    Returns
    -------
    Format
        The format.

    Raises
    ------
    ExportError
        If there is no such format.

    Examples
    --------
    >>> format_of("scene.ome.tif").name
    'ome-tiff'
    """
    formats = all_formats()
    if name is not None:
        if name not in formats:
            raise ExportError(f"no format {name!r}: choose one of {', '.join(formats)}")
        return formats[name]
    lower = Path(path).name.lower()
    for entry in formats.values():  # .ome.tif precedes .tif
        if lower.endswith(entry.endings):
            return entry
    endings = ", ".join(entry.endings[0] for entry in formats.values())
    raise ExportError(f"{str(path)!r} ends in none of {endings}: rename it or name a format")


@within_memory("the writing of an image", advice=NOTHING_LEFT)
@takes(image=xr.Dataset, path=PATH, format=TEXT, overwrite=SWITCH)
def write(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    format: str | None = None,  # noqa: A002 - the usual name
    overwrite: bool = False,
    **options: Any,
) -> list[Path]:
    """Write an image or a series in the format that the file extension selects.

    Parameters
    ----------
    image : xarray.Dataset
        Image that `reconstruct` made, preferably with the metadata that `describe` adds; or a
        series (`analysis.stack`).
    path : str or pathlib.Path
        Name of the file. If the format holds only one image, each image of a series is written to
        a file of its own, with a number before the extension.
    format : str, optional
        Name of a format, which overrides the file extension.
    overwrite : bool
        Whether existing files of these names may be replaced.
    **options : Any
        Options of the format: `regions` (csv), `variable`, `band` (png, tiff), `limits` (png),
        `bad_bands` (envi), `instrument` (ply, las, foxglove), `interval_s` (foxglove).

    Returns
    -------
    list of pathlib.Path
        The files or folders that were written.

    Raises
    ------
    ExportError
        If there is no such format or option.
    ImageError
        If it is not an image.
    OutputError
        If a file exists already or can't be written.
    MemoryLimitError
        If memory is exhausted.
    """
    require_image(image)
    chosen = format_of(path, format)
    _refuse_unknown(chosen, options)
    path = Path(path)
    singles = captures(image)
    if chosen.series or len(singles) == 1:
        whole = image if chosen.series else singles[0]
        chosen.write(whole, path, overwrite=overwrite, **options)
        return [path]
    ending = next((e for e in chosen.endings if path.name.lower().endswith(e)), "")
    stem = path.name[: len(path.name) - len(ending)]
    digits = len(str(len(singles) - 1))
    written = []
    for number, single in enumerate(singles):
        name = path.with_name(f"{stem}-{number:0{digits}d}{path.name[len(stem) :]}")
        chosen.write(single, name, overwrite=overwrite, **options)
        written.append(name)
    return written


def _refuse_unknown(chosen: Format, options: dict[str, Any]) -> None:
    parameters = signature(chosen.write).parameters.values()
    keywords = {p.name for p in parameters if p.kind == p.KEYWORD_ONLY} - {"overwrite"}
    if unknown := sorted(set(options) - keywords):
        known = f"it has {', '.join(sorted(keywords))}" if keywords else "it has none"
        raise ExportError(f"format {chosen.name!r} has no option {unknown[0]!r}: {known}")
