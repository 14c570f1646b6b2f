"""A list of a folder's files with their checksums, so that a damaged copy is noticed.

A Zarr store that lacks a file reads as if nothing had been measured there, and a chunk that was
cut short may decompress to anything.
"""

from __future__ import annotations

import json
from pathlib import Path

import google_crc32c

from hueflight.errors import FileFormatError

SEAL = ".checksums"  #: name of the list, which Zarr libraries pass over


def seal(folder: Path) -> None:
    """Write the list: relative path → CRC-32C of the content."""
    sums = {
        path.relative_to(folder).as_posix(): google_crc32c.value(path.read_bytes())
        for path in _files(folder)
    }
    (folder / SEAL).write_text(json.dumps(sums, indent=0), encoding="utf-8")


def check_seal(folder: Path) -> None:
    """Hold a folder against its list, if it has one.

    Raises
    ------
    FileFormatError
        If a file is missing, has changed, or was added.
    """
    path = folder / SEAL
    if not path.exists():
        return  # written by other software
    try:
        sums = json.loads(path.read_text(encoding="utf-8"))
        entries = [(str(name), int(value)) for name, value in sums.items()]
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise FileFormatError(f"{str(folder)!r}: its list of checksums is damaged") from error
    added = {path.relative_to(folder).as_posix() for path in _files(folder)} - set(sums)
    if added:
        raise FileFormatError(
            f"{str(folder)!r} was changed: {min(added)} was not written with it. If that is meant, "
            f"remove its list {SEAL}"
        )
    for name, wanted in entries:
        member = folder / name
        if not member.is_file():
            raise FileFormatError(
                f"{str(folder)!r} is incomplete: {name} is missing. Copy it again, or make it again"
            )
        if google_crc32c.value(member.read_bytes()) != wanted:
            raise FileFormatError(
                f"{str(folder)!r} is damaged: {name} is not what was written (its checksum "
                "differs). Copy it again, or make it again"
            )


def _files(folder: Path) -> list[Path]:
    """All files but the list itself."""
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SEAL)
