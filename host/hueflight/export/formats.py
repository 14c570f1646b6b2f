"""All formats by name and ending, and one door to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any

import xarray as xr

from hueflight.errors import ExportError
from hueflight.export.envi import write_envi
from hueflight.export.las import write_las
from hueflight.export.ome import write_ome_tiff
from hueflight.export.ply import write_ply
from hueflight.export.preview import write_png, write_previews
from hueflight.export.stores import write_netcdf, write_zarr
from hueflight.export.tables import write_csv
from hueflight.export.tiff import write_tiff
from hueflight.files.image_schema import captures, require_image


@dataclass(frozen=True)
class Format:
    """A way to write images.

    Attributes
    ----------
    name : how it is chosen.
    endings : of file names that mean it, the first is usual.
    write : ``write(image, path, overwrite=…, …)``.
    series : whether one file holds a whole series.
    summary : what it is for.
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
        Format("png", (".png",), write_png, False, "one plane with its colour bar"),
        Format("previews", (".previews",), write_previews, False, "a folder of all pictures"),
        Format("csv", (".csv",), write_csv, True, "spectra of regions"),
    )
}


def format_of(path: str | Path, name: str | None = None) -> Format:
    """The format named, or the one that the path's ending means.

    Raises
    ------
    ExportError
        If there is none such.

    Examples
    --------
    >>> format_of("scene.ome.tif").name
    'ome-tiff'
    """
    if name is not None:
        if name not in FORMATS:
            raise ExportError(f"no format {name!r}: choose one of {', '.join(FORMATS)}")
        return FORMATS[name]
    lower = Path(path).name.lower()
    for entry in FORMATS.values():  # .ome.tif stands before .tif
        if lower.endswith(entry.endings):
            return entry
    endings = ", ".join(entry.endings[0] for entry in FORMATS.values())
    raise ExportError(f"{str(path)!r} ends in none of {endings}: rename it or name a format")


def write(
    image: xr.Dataset,
    path: str | Path,
    /,
    *,
    format: str | None = None,  # noqa: A002 - the word users know
    overwrite: bool = False,
    **options: Any,
) -> list[Path]:
    """Write an image or a series; returns the files or folders that were named.

    Parameters
    ----------
    image : as `reconstruct` gives, best after `describe`; or a series (`analysis.stack`).
    path : its ending chooses the format. For a series in a format that holds one image, a
        number is put before the ending, one file each.
    format : name of a format, whatever the ending.
    overwrite : whether a file of that name may be replaced.
    options : of the format: `regions` (csv), `variable`, `band`, `limits` (png), `bad_bands`
        (envi), `instrument` (ply, las).

    Raises
    ------
    ExportError
        If the format or an option does not exist, the file does, or the disk did not take it.
    ImageError
        If it is no image.
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
