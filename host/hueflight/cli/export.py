"""hueflight export"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hueflight.cli.app import app
from hueflight.cli.output import show
from hueflight.export import FORMATS, write
from hueflight.importers import read_image


@app.command
def export(
    image: Path,
    out: Path,
    *,
    format: Annotated[str | None, Parameter(name=["--format", "-f"])] = None,  # noqa: A002
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write an image in a format that other tools open.

    Parameters
    ----------
    image
        What `hueflight reconstruct` wrote (.zarr), or a NetCDF file of ours.
    out
        The file to write. Its ending chooses the format: .nc, .ome.tif, .tif, .hdr (ENVI),
        .ply, .las, .png, .previews (a folder of pictures), .csv, .zarr.
    format
        Name of a format, whatever the ending.
    overwrite
        Replace a file of that name.
    json
        Print the result as JSON.
    """
    written = write(read_image(image), out, format=format, overwrite=overwrite)
    show(f"Export of {image}", {"files": [str(path) for path in written]}, json_wanted=json)


export.__doc__ = (export.__doc__ or "").replace(
    "other tools open.",
    "other tools open: " + "; ".join(f"{f.name}, {f.summary}" for f in FORMATS.values()) + ".",
    1,
)
