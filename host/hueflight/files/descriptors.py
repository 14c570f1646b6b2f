# SPDX-License-Identifier: Apache-2.0
"""Descriptors of files where systems differ: reading at a place, names that are kept."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Lock

BINARY = getattr(os, "O_BINARY", 0)  #: Windows translates the ends of lines without it
_position = Lock()  # of descriptors that have to be moved before they are read


def open_to_read(path: str | Path, /) -> int:
    """Open a file for `read_at` and `read_into`.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    int
        Its descriptor, which the caller closes.
    """
    return os.open(path, os.O_RDONLY | BINARY)


def read_at(fd: int, size: int, offset: int, /) -> bytes:
    """Read at a place; several threads may use one descriptor.

    Parameters
    ----------
    fd : int
        Descriptor from `open_to_read`.
    size : int
        Number of bytes.
    offset : int
        Place of the first one.

    Returns
    -------
    bytes
        The bytes; fewer at the end of the file.
    """
    if hasattr(os, "pread"):
        return os.pread(fd, size, offset)
    with _position:
        os.lseek(fd, offset, os.SEEK_SET)
        return os.read(fd, size)


def read_into(fd: int, space: memoryview, offset: int, /) -> int:
    """Read at a place into memory, without a copy where the system can.

    Parameters
    ----------
    fd : int
        Descriptor from `open_to_read`.
    space : memoryview
        Where the bytes go.
    offset : int
        Place of the first one in the file.

    Returns
    -------
    int
        Number of bytes that were read; 0 at the end of the file.
    """
    if hasattr(os, "preadv"):
        return os.preadv(fd, [space], offset)
    data = read_at(fd, len(space), offset)
    space[: len(data)] = data
    return len(data)


def sync_folder(folder: Path, /) -> None:
    """Wait until the disk holds the names in a folder, so that they survive a power cut.

    Parameters
    ----------
    folder : Path
        The folder. On Windows, which can't open folders, nothing is done.
    """
    if os.name == "nt":
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
