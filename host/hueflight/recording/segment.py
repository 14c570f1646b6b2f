# SPDX-License-Identifier: Apache-2.0
"""One file of a recording: appended record by record, finished with an index, then renamed."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
from mcap.records import (
    Attachment,
    AttachmentIndex,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Statistics,
)

from hueflight.files.descriptors import BINARY, sync_folder
from hueflight.recording.layout import (
    CHANNEL,
    CLOSING,
    DESCRIPTION,
    FRAME_INDEX,
    INDEX,
    INSTRUMENT,
    PROFILE,
    Closing,
    Description,
    part_path,
)
from hueflight.recording.records import (
    DATA_END,
    MAGIC,
    MESSAGE_BYTES,
    PAYLOAD_OFFSET,
    encode,
    encode_chunk,
    encode_summary,
)

JSON = "application/json"
FAILURES = (OSError, MemoryError)
"""What ends a segment: a disk that is full or has vanished, and memory that is exhausted."""


class Segment:
    """Writes one file, which keeps its whole records after any `OSError` or `MemoryError`.

    Parameters
    ----------
    path : Path
        Final path; until `finish` the name ends in ``.part``.
    description : Description
        Identity of recording and segment, and metadata.
    instrument_json : str
        Instrument as JSON.
    attachments : dict of bytes
        Further attachments by name.
    first : int
        Frames of the recording before this segment.

    Attributes
    ----------
    size : int
        Bytes of whole records written.
    settled : int
        Bytes of whole records that survive a power cut.
    frames : int
        Frames in this segment.
    """

    def __init__(
        self,
        path: Path,
        description: Description,
        instrument_json: str,
        attachments: dict[str, bytes],
        *,
        first: int = 0,
    ) -> None:
        self.path = path
        self.size = self.settled = 0
        self.first = first
        self.frames = 0
        self.started = time.monotonic()
        self._unkept: OSError | None = None
        self._attached: list[AttachmentIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._index: list[tuple[int, ...]] = []
        self._fd = os.open(part_path(path), os.O_WRONLY | os.O_CREAT | os.O_EXCL | BINARY, 0o644)
        try:
            self._append([MAGIC, encode(Header(PROFILE, f"hueflight-{description.format}"))])
            self._attach(INSTRUMENT, JSON, instrument_json.encode())
            self._attach(DESCRIPTION, JSON, msgspec.json.encode(description))
            for name, data in attachments.items():
                self._attach(name, "application/octet-stream", data)
            capture = encode(Metadata("capture", description.metadata))
            self._capture = MetadataIndex(self._append([capture]), len(capture), "capture")
            self._append([encode(CHANNEL)])
        except FAILURES:
            self.abandon()
            with suppress(OSError):
                part_path(path).unlink(missing_ok=True)
            raise

    def append_chunk(
        self,
        payload: memoryview,
        *,
        frames: int,
        log_time: int,
        tick: int,
        clock_hz: int,
        sequence: int,
        has_sequence: int,
    ) -> None:
        """Append packets; when this returns, they survive the end of this program."""
        publish_time = tick * 1_000_000_000 // clock_hz if clock_hz else 0
        ordinal, frames_then = self.first + self.frames, self.frames + frames
        head, tail = encode_chunk(
            payload,
            sequence=ordinal,
            log_time=log_time,
            publish_time=publish_time & 0xFFFF_FFFF_FFFF_FFFF,
        )
        start, length = self.size, len(head) + len(payload)
        size = MESSAGE_BYTES + len(payload)
        chunk = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression="",
            compressed_size=size,
            message_end_time=log_time,
            message_index_length=len(tail),
            message_index_offsets={CHANNEL.id: start + length},
            message_start_time=log_time,
            uncompressed_size=size,
        )
        entry = (start + PAYLOAD_OFFSET, len(payload), ordinal, frames)
        known = len(self._chunks)
        try:  # the entries first: then nothing is in the file that the index lacks
            self._index.append((*entry, sequence, has_sequence, clock_hz, tick, log_time))
            self._chunks.append(chunk)
            self._append([head, payload, tail])
        except FAILURES:
            del self._chunks[known:], self._index[known:]
            raise
        self.frames = frames_then

    def settle(self) -> None:
        """Wait until the disk has all that was written, and drop it from the page cache.

        A long recording would push everything else out of the page cache. Reused memory also takes
        less time to fill than memory that was never used.
        """
        begin, end = self.settled, self.size
        try:
            os.fsync(self._fd)
            if not begin:  # bytes are of no use in a file whose name is lost
                sync_folder(self.path.parent)
        except OSError as error:
            self._unkept = error
            raise
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(self._fd, begin, end - begin, os.POSIX_FADV_DONTNEED)
        self.settled = end

    def finish(self, *, last: bool, report: dict[str, int]) -> None:
        """Write index and summary, wait for the disk, and give the file its final name."""
        try:
            if self._unkept is not None:  # the system reports lost bytes only once
                raise self._unkept
            self._finish(last=last, report=report)
        finally:
            self.abandon()

    def _finish(self, *, last: bool, report: dict[str, int]) -> None:
        closing = Closing(first=self.first, frames=self.frames, last=last, report=report)
        self._attach(INDEX, "application/octet-stream", self._index_bytes())
        self._attach(CLOSING, JSON, msgspec.json.encode(closing))
        self._append([DATA_END])
        statistics = Statistics(
            attachment_count=len(self._attached),
            channel_count=1,
            channel_message_counts={CHANNEL.id: len(self._chunks)},
            chunk_count=len(self._chunks),
            message_count=len(self._chunks),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            metadata_count=1,
            schema_count=0,
        )
        summary = encode_summary(
            self.size, CHANNEL, statistics, self._chunks, self._attached, [self._capture]
        )
        self._append([summary])
        self.settle()
        part_path(self.path).replace(self.path)
        sync_folder(self.path.parent)

    def abandon(self) -> None:
        """Close the file as it is, with the whole records written so far."""
        if self._fd >= 0:
            with suppress(OSError):
                os.close(self._fd)
            self._fd = -1

    def _index_bytes(self) -> bytes:
        return np.array(self._index, FRAME_INDEX).tobytes()

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        now = time.time_ns()
        record = encode(Attachment(now, now, name, media_type, data))
        offset = self._append([record])
        self._attached.append(
            AttachmentIndex(offset, len(record), now, now, len(data), name, media_type)
        )

    def _append(self, parts: Sequence[bytes | memoryview]) -> int:
        """Write all of the parts, or leave the file as it was and raise; return their place."""
        start, left = self.size, [memoryview(part) for part in parts]
        end = start + sum(len(part) for part in left)
        try:
            while left:
                written = os.writev(self._fd, left)
                while left and written >= len(left[0]):
                    written -= len(left.pop(0))
                if left:
                    left[0] = left[0][written:]
        except FAILURES:
            with suppress(OSError):
                os.ftruncate(self._fd, start)
                os.lseek(self._fd, start, os.SEEK_SET)
            raise
        self.size = end
        return start
