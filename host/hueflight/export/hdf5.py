"""HDF5 files on disks that may be full.

The HDF5 library does not survive a refused write: closing fails, is tried again when the
interpreter tidies up, and may take the process down. So it writes to a file object that, once
the disk refuses, keeps the little that still comes in memory, lets HDF5 close in peace, and
reports the refusal then.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class PatientFile(io.FileIO):
    """A new file for reading and writing that keeps a refused write for `settle`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.refusal: OSError | None = None
        self._spilled: list[tuple[int, bytes]] = []  # (offset, content), in order of writing
        self._end = 0  # of the file, spilled parts included

    def write(self, data: Any, /) -> int:
        """Write all of it, to memory if need be."""
        view = memoryview(data).cast("B")
        offset, written = self.tell(), 0
        while self.refusal is None and written < len(view):
            try:
                written += super().write(view[written:]) or 0
            except OSError as error:
                self.refusal = error
        if written < len(view):
            self._spilled.append((offset + written, bytes(view[written:])))
        self.seek(offset + len(view))
        self._end = max(self._end, offset + len(view))
        return len(view)

    def readinto(self, buffer: Any, /) -> int:
        """Read what was written, wherever it is kept."""
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
        """Move; the end is that of all that was written."""
        if whence == os.SEEK_END:
            return super().seek(self._end + offset)
        return super().seek(offset, whence)

    def truncate(self, size: int | None = None, /) -> int:
        """Set the file's length."""
        length = self.tell() if size is None else size
        if self.refusal is None:
            try:
                super().truncate(length)
            except OSError as error:
                self.refusal = error
        self._end = length
        return length

    def settle(self) -> None:
        """Raise what the disk refused."""
        if self.refusal is not None:
            raise self.refusal


@contextmanager
def patient_file(path: Path) -> Iterator[PatientFile]:
    """A file that HDF5 may write to; a refusal is raised when the block ends.

    Raises
    ------
    OSError
        If the disk did not take everything.
    """
    with PatientFile(path) as file:
        yield file
        file.settle()
