# SPDX-License-Identifier: Apache-2.0
"""One finished file of a recording: description, index, and bytes on demand."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from mcap.records import Attachment, AttachmentIndex
from numpy.typing import NDArray

from hueflight.errors import RecordingError
from hueflight.files.descriptors import open_to_read, read_into
from hueflight.recording.layout import (
    CLOSING,
    DESCRIPTION,
    FORMAT,
    FRAME_INDEX,
    INDEX,
    Closing,
    Description,
)
from hueflight.recording.records import decode_attachment, read_summary

_Document = TypeVar("_Document")


class SegmentReader:
    """Reads a finished segment.

    Parameters
    ----------
    path : Path
        Path of the file.

    Attributes
    ----------
    size : int
        Bytes of the file.
    description : Description
        Identity of recording and segment, and metadata.
    closing : Closing
        Totals of the segment.
    index : structured array, shape (chunk,)
        Entries of type `hueflight.recording.layout.FRAME_INDEX`.

    Raises
    ------
    RecordingError
        If the file can't be read, is not a recording of Hueflight, or was not finished.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd = -1
        try:
            self._fd = open_to_read(path)
            self.size = os.fstat(self._fd).st_size
            self._attached = {each.name: each for each in read_summary(self.read, self.size)}
            self.description = self._document(DESCRIPTION, Description)
            self._check_format()
            self.closing = self._document(CLOSING, Closing)
            self.index = self._read_index()
        except OSError as error:
            self.close()
            raise RecordingError(f"can't read {path}: {error.strerror or error}") from None
        except RecordingError as error:
            self.close()
            raise RecordingError(f"{path} can't be used: {error}") from None

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def read(self, offset: int, size: int) -> bytes:
        """Return bytes of the file.

        Parameters
        ----------
        offset : int
            Place of the first byte.
        size : int
            Number of bytes.

        Returns
        -------
        bytes
            The bytes.

        Raises
        ------
        RecordingError
            If the file ends before them, or they can't be read.
        """
        data = bytearray(size)
        self.read_into(memoryview(data), offset)
        return bytes(data)

    def read_into(self, space: memoryview, offset: int) -> None:
        """Fill `space` with the bytes at `offset`; raises the errors of `read`."""
        done = 0
        while done < len(space):
            try:
                got = read_into(self._fd, space[done:], offset + done)
            except OSError as error:
                raise RecordingError(
                    f"can't read {self.path} at byte {offset + done}: {error.strerror or error}"
                ) from None
            if not got:
                raise RecordingError(
                    f"{self.path} ends at byte {offset + done}, {len(space) - done} bytes early"
                )
            done += got

    def attachment(self, name: str, /) -> bytes:
        """Return the content of an attachment.

        Parameters
        ----------
        name : str
            Name of the attachment.

        Returns
        -------
        bytes
            Its content.

        Raises
        ------
        RecordingError
            If there is no attachment of this name, or it is damaged.
        """
        if name not in self._attached:
            raise RecordingError(
                f"{self.path} has no attachment {name!r}: it has {', '.join(self._attached)}"
            )
        place: AttachmentIndex = self._attached[name]
        if place.offset + place.length > self.size:
            raise RecordingError(f"attachment {name!r} lies outside the file; try recover")
        attached: Attachment = decode_attachment(self.read(place.offset, place.length))
        if attached.name != name:
            raise RecordingError(
                f"attachment {name!r} is called {attached.name!r} in its place; try recover"
            )
        return attached.data

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of all attachments."""
        return tuple(self._attached)

    def _document(self, name: str, kind: type[_Document]) -> _Document:
        if name not in self._attached:
            raise RecordingError("it is an MCAP file, but not a recording of Hueflight")
        try:
            return msgspec.json.decode(self.attachment(name), type=kind)
        except msgspec.DecodeError as error:
            raise RecordingError(f"{name} is damaged: {error}; try recover") from None

    def _check_format(self) -> None:
        if self.description.format != FORMAT:
            raise RecordingError(
                f"its format is {self.description.format}, this program reads {FORMAT}"
            )

    def _read_index(self) -> NDArray[Any]:
        octets = self.attachment(INDEX)
        if len(octets) % FRAME_INDEX.itemsize:
            raise RecordingError("its index of frames is damaged; try recover")
        index = np.frombuffer(octets, FRAME_INDEX)
        firsts = self.closing.first + np.cumsum(index["frames"]) - index["frames"]
        inside = index["offset"] + index["size"] <= self.size
        if not (inside.all() and (index["first"] == firsts).all()):
            raise RecordingError("its index of frames contradicts itself; try recover")
        return index
