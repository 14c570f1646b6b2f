# SPDX-License-Identifier: Apache-2.0
"""HDF5 files on disks that may be full.

The HDF5 library cannot recover from a failed write: closing the file fails, is tried again when the
interpreter exits, and may crash the process. Therefore HDF5 writes to a file object that keeps all
further data in memory after a failed write, so that the file can be closed, and then reports the
error.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class BufferingFile(io.FileIO):
    """A new file for reading and writing that reports a failed write only in `raise_failure`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.failure: OSError | None = None
        self._spilled: list[tuple[int, bytes]] = []  # (offset, content), in order of writing
        self._end = 0  # of the file, including the parts in memory

    def write(self, data: Any, /) -> int:
        """Write all data, to memory if the disk refuses."""
        view = memoryview(data).cast("B")
        offset, written = self.tell(), 0
        while self.failure is None and written < len(view):
            try:
                written += super().write(view[written:]) or 0
            except OSError as error:
                self.failure = error
        if written < len(view):
            self._spilled.append((offset + written, bytes(view[written:])))
        self.seek(offset + len(view))
        self._end = max(self._end, offset + len(view))
        return len(view)

    def readinto(self, buffer: Any, /) -> int:
        """Read what was written, from the disk and from memory."""
        view = memoryview(buffer).cast("B")
        offset = self.tell()
        length = max(0, min(len(view), self._end - offset))
        done = 0
        while done < length and (got := super().readinto(view[done:length])):
            done += got
        view[done:length] = bytes(length - done)
        for start, content in self._spilled:
            low, high = max(start, offset), min(start + len(content), offset + length)
            if low < high:
                view[low - offset : high - offset] = content[low - start : high - start]
        self.seek(offset + length)
        return length

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move to an offset; the end of the file includes the parts in memory."""
        if whence == os.SEEK_END:
            return super().seek(self._end + offset)
        return super().seek(offset, whence)

    def truncate(self, size: int | None = None, /) -> int:
        """Set the length of the file."""
        length = self.tell() if size is None else size
        if self.failure is None:
            try:
                super().truncate(length)
            except OSError as error:
                self.failure = error
        self._end = length
        return length

    def raise_failure(self) -> None:
        """Raise the error of the first failed write, if there was one."""
        if self.failure is not None:
            raise self.failure


@contextmanager
def buffering_file(path: Path) -> Iterator[BufferingFile]:
    """Open a file for HDF5 and raise the error of a failed write when the block ends.

    Parameters
    ----------
    path : pathlib.Path
        Name of the new file.

    Yields
    ------
    BufferingFile
        The file.

    Raises
    ------
    OSError
        If not everything could be written.
    """
    with BufferingFile(path) as file:
        yield file
        file.raise_failure()
