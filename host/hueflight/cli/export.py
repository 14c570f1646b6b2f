"""The command `hueflight export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hueflight.cli.output import show
from hueflight.export import FORMATS, write
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
    overwrite : bool, default False
        Replace existing files of that name.
    json : bool, default False
        Print one JSON object instead of a table.
    """
    written = write(read_image(image), out, format=format, overwrite=overwrite)
    show(f"Export of {image}", {"files": [str(path) for path in written]}, json_wanted=json)
