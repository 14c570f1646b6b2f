# SPDX-License-Identifier: Apache-2.0
"""A list of a folder's files with their checksums, so that a damaged copy is noticed.

Zarr reads a missing chunk as zeros without a complaint, and a chunk that was cut short may
decompress to anything.
"""

from __future__ import annotations

import json
from pathlib import Path

import google_crc32c

from hueflight.errors import FileFormatError

CHECKSUM_LIST = ".checksums"  #: name of the list in its folder, which Zarr libraries pass over


def write_checksums(folder: Path) -> None:
    """Write the list of a folder's files.

    Parameters
    ----------
    folder : Path
        Every file below it is listed by relative path, with the CRC-32C of its content.
    """
    sums = {
        path.relative_to(folder).as_posix(): google_crc32c.value(path.read_bytes())
        for path in _files(folder)
    }
    (folder / CHECKSUM_LIST).write_text(json.dumps(sums, indent=0), encoding="utf-8")


def verify_checksums(folder: Path) -> bool:
    """Compare a folder with its list, if it has one.

    Parameters
    ----------
    folder : Path
        A folder, for example a Zarr store.

    Returns
    -------
    bool
        False if the folder has no list, because other software wrote it.

    Raises
    ------
    FileFormatError
        If a file is missing, has changed, or was added.
    """
    path = folder / CHECKSUM_LIST
    if not path.exists():
        return False
    try:
        sums = json.loads(path.read_text(encoding="utf-8"))
        entries = [(str(name), int(value)) for name, value in sums.items()]
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise FileFormatError(f"{str(folder)!r}: its list of checksums is damaged") from error
    added = {path.relative_to(folder).as_posix() for path in _files(folder)} - set(sums)
    if added:
        raise FileFormatError(
            f"{str(folder)!r} was changed: {min(added)} was not written with it. If that is meant, "
            f"remove its list {CHECKSUM_LIST}"
        )
    for name, wanted in entries:
        member = folder / name
        if not member.is_file():
            raise FileFormatError(
                f"{str(folder)!r} is incomplete: {name} is missing. Copy it again, or make it again"
            )
        if google_crc32c.value(member.read_bytes()) != wanted:
            raise FileFormatError(
                f"{str(folder)!r} is damaged: the checksum of {name} differs from the one that was "
                "written with it. Copy it again, or make it again"
            )
    return True


def require_checksums(folder: Path) -> None:
    """Compare a folder with the list that it must have.

    Parameters
    ----------
    folder : Path
        A folder that was written with its list.

    Raises
    ------
    FileFormatError
        If the list or a file is missing, or a file has changed or was added.
    """
    if not verify_checksums(folder):
        raise FileFormatError(
            f"{str(folder)!r} is incomplete: its list {CHECKSUM_LIST} is missing. Copy it again, "
            "or make it again"
        )


def _files(folder: Path) -> list[Path]:
    """All files but the list itself."""
    return sorted(
        path for path in folder.rglob("*") if path.is_file() and path.name != CHECKSUM_LIST
    )
