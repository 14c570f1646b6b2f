# SPDX-License-Identifier: Apache-2.0
"""Room on the disk under a folder, and whether it is still the same disk."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from hueflight.errors import RecordingError


class Room:
    """The file system that a folder lies on when this is made.

    If its disk is unmounted later, the folder lies on the file system of the mount point; nothing
    may be written there in its place.

    Parameters
    ----------
    folder : Path
        A folder that exists.

    Raises
    ------
    OSError
        If the folder can't be examined.
    """

    def __init__(self, folder: Path, /) -> None:
        self.folder = folder
        self._file_system, _ = _examine(folder)

    def free_bytes(self) -> int:
        """Return the space that users other than root may fill, in bytes.

        Returns
        -------
        int
            Number of bytes.

        Raises
        ------
        RecordingError
            If the folder is gone, or lies on another file system than before.
        OSError
            If the disk does not answer.
        """
        try:
            file_system, free = _examine(self.folder)
        except (FileNotFoundError, NotADirectoryError):
            raise RecordingError(
                f"the folder {self.folder} is gone: mount its disk again"
            ) from None
        if file_system != self._file_system:
            raise RecordingError(
                f"the folder {self.folder} is no longer on the disk that it was on: mount it again"
            )
        return free

    def require(self, size: int, /, *, reserve: int) -> int:
        """Check that there is room, and return how much would be left.

        Parameters
        ----------
        size : int
            Bytes that are to be written.
        reserve : int
            Bytes that must stay free besides.

        Returns
        -------
        int
            Bytes that could be written beyond these.

        Raises
        ------
        RecordingError
            If there is less room, or `free_bytes` raises it.
        OSError
            If the disk does not answer.
        """
        free = self.free_bytes()
        if free - size < reserve:
            raise RecordingError(
                f"only {free >> 20} MiB are free under {self.folder}, recording needs more than "
                f"{reserve >> 20} MiB: make room or choose another folder"
            )
        return free - size - reserve


def _examine(folder: Path) -> tuple[tuple[int, int], int]:
    """Identity of a folder's file system, which outlives mounting it again, and its room."""
    status = folder.stat()
    if not hasattr(os, "statvfs"):  # Windows
        return (status.st_dev, 0), shutil.disk_usage(folder).free
    found = os.statvfs(folder)
    # file systems without an identity of their own have the number of their device
    identity = (0, found.f_fsid) if found.f_fsid else (status.st_dev, 0)
    return identity, found.f_bavail * found.f_frsize
