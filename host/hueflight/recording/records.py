# SPDX-License-Identifier: Apache-2.0
"""MCAP records, written and read with every size checked.

A recording is plain MCAP: https://mcap.dev/spec. The `mcap` library encodes all records except the
chunk, which carries the stream and is laid out here, so that packets go from the buffer to the file
without a copy.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MessageIndex,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from hueflight.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
CHANNEL_ID = 1
RECORD_HEAD = struct.Struct("<BQ")  # opcode, bytes that follow
_CHUNK_HEAD = struct.Struct("<QQQIIQ")  # times, size, CRC, no compression's name, size
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, times
PAYLOAD_OFFSET = RECORD_HEAD.size + _CHUNK_HEAD.size + RECORD_HEAD.size + _MESSAGE_HEAD.size
"""From a chunk's start to its packets."""
MESSAGE_BYTES = RECORD_HEAD.size + _MESSAGE_HEAD.size
"""What the message adds to its packets."""
FOOTER_BYTES = RECORD_HEAD.size + 20

_Record = TypeVar("_Record", bound=McapRecord)


def encode(*records: McapRecord) -> bytes:
    """Return records as bytes."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def encode_chunk(
    payload: memoryview, *, sequence: int, log_time: int, publish_time: int
) -> tuple[bytes, bytes]:
    """Return the bytes before and after a chunk's packets, which are one uncompressed message."""
    message = RECORD_HEAD.pack(Opcode.MESSAGE, _MESSAGE_HEAD.size + len(payload))
    message += _MESSAGE_HEAD.pack(CHANNEL_ID, sequence & 0xFFFF_FFFF, log_time, publish_time)
    size = len(message) + len(payload)
    crc = zlib.crc32(payload, zlib.crc32(message))
    head = RECORD_HEAD.pack(Opcode.CHUNK, _CHUNK_HEAD.size + size)
    head += _CHUNK_HEAD.pack(log_time, log_time, size, crc, 0, size)
    return head + message, encode(MessageIndex(CHANNEL_ID, [(log_time, 0)]))


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk with a correct CRC.

    Attributes
    ----------
    log_time : int
        Host clock, nanoseconds since 1970.
    publish_time : int
        Device clock, in nanoseconds.
    payload : memoryview
        The packets.
    """

    log_time: int
    publish_time: int
    payload: memoryview


def decode_chunk(record: memoryview, /) -> Chunk | None:
    """Return the chunk in a record, or None if it has another layout or its CRC is wrong."""
    if len(record) < PAYLOAD_OFFSET:
        return None
    opcode, length = RECORD_HEAD.unpack_from(record)
    start, _, size, crc, compression, stored = _CHUNK_HEAD.unpack_from(record, RECORD_HEAD.size)
    inner = record[RECORD_HEAD.size + _CHUNK_HEAD.size :]
    if (opcode, compression) != (Opcode.CHUNK, 0) or length != len(record) - RECORD_HEAD.size:
        return None
    if not len(inner) == size == stored or zlib.crc32(inner) != crc:
        return None
    opcode, length = RECORD_HEAD.unpack_from(inner)
    channel, _, _, publish_time = _MESSAGE_HEAD.unpack_from(inner, RECORD_HEAD.size)
    if (opcode, channel) != (Opcode.MESSAGE, CHANNEL_ID) or length != size - RECORD_HEAD.size:
        return None
    return Chunk(start, publish_time, record[PAYLOAD_OFFSET:])


def decode(kind: type[_Record], content: bytes, /) -> _Record:
    """Return the record of a `kind` from its content.

    Raises
    ------
    RecordingError
        If the content is not such a record.
    """
    try:
        stream = ReadDataStream(BytesIO(content))
        record = kind.read(stream)  # pyright: ignore[reportAttributeAccessIssue]
    except (McapError, struct.error, UnicodeDecodeError, ValueError, OverflowError) as error:
        raise RecordingError(f"a damaged {kind.__name__} record: {error}; try recover") from None
    if stream.count != len(content):
        raise RecordingError(
            f"a damaged {kind.__name__} record: {stream.count} of {len(content)} bytes are used; "
            "try recover"
        )
    return record


def decode_attachment(record: bytes, /) -> Attachment:
    """Return the attachment in a whole record, after checking its CRC.

    Raises
    ------
    RecordingError
        If it is damaged.
    """
    content = record[RECORD_HEAD.size :]
    opcode, length = RECORD_HEAD.unpack_from(record.ljust(RECORD_HEAD.size, b"\0"))
    if (opcode, length) != (Opcode.ATTACHMENT, len(content)) or len(content) < 4:
        raise RecordingError("no attachment where the index says there is one; try recover")
    if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
        raise RecordingError("an attachment's CRC is wrong; try recover")
    return decode(Attachment, content)


def walk(
    read: Callable[[int, int], bytes], start: int, stop: int, /
) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, place and size of the whole records between two places of a file."""
    while stop - start >= RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(read(start, RECORD_HEAD.size))
        size = RECORD_HEAD.size + length
        if opcode == 0 or size > stop - start:
            return
        yield opcode, start, size
        start += size


def encode_summary(
    start: int,
    channel: Channel,
    statistics: Statistics,
    chunks: list[ChunkIndex],
    attachments: list[AttachmentIndex],
    metadata: list[MetadataIndex],
    *,
    schemas: Sequence[Schema] = (),
    channels: Sequence[Channel] = (),
) -> bytes:
    """Return the end of a file whose summary begins at byte `start`: summary, footer, magic.

    `channels` are those besides the one of the packets, and `schemas` theirs.
    """
    groups: list[tuple[Opcode, bytes]] = [
        (Opcode.SCHEMA, encode(*schemas)),
        (Opcode.CHANNEL, encode(channel, *channels)),
        (Opcode.STATISTICS, encode(statistics)),
        (Opcode.CHUNK_INDEX, encode(*chunks)),
        (Opcode.ATTACHMENT_INDEX, encode(*attachments)),
        (Opcode.METADATA_INDEX, encode(*metadata)),
    ]
    body, offsets = b"", b""
    for opcode, group in groups:
        if group:
            offsets += encode(SummaryOffset(opcode, len(group), start + len(body)))
        body += group
    footer = encode(Footer(start, start + len(body), 0))[:-4]
    crc = zlib.crc32(body + offsets + footer)
    return body + offsets + footer + crc.to_bytes(4, "little") + MAGIC


def read_summary(read: Callable[[int, int], bytes], size: int, /) -> list[AttachmentIndex]:
    """Return the places of the attachments in a finished file of `size` bytes.

    Raises
    ------
    RecordingError
        If the file is not an MCAP file, has no end, or its end is damaged.
    """
    if read(0, min(size, len(MAGIC))) != MAGIC:
        raise RecordingError("it is not an MCAP file")
    end = size - FOOTER_BYTES - len(MAGIC)
    if end < len(MAGIC) or read(size - len(MAGIC), len(MAGIC)) != MAGIC:
        raise RecordingError("it has no end: the recording was cut short; try recover")
    footer_record = read(end, FOOTER_BYTES)
    footer = decode(Footer, footer_record[RECORD_HEAD.size :])
    start = footer.summary_start
    if RECORD_HEAD.unpack_from(footer_record) != (Opcode.FOOTER, 20) or not 0 < start <= end:
        raise RecordingError("its footer is damaged; try recover")
    summary = read(start, end - start)
    if zlib.crc32(summary + footer_record[:-4]) != footer.summary_crc:
        raise RecordingError("its summary is damaged; try recover")
    return [
        decode(AttachmentIndex, summary[at + RECORD_HEAD.size : at + length])
        for opcode, at, length in walk(lambda at, n: summary[at : at + n], 0, len(summary))
        if opcode == Opcode.ATTACHMENT_INDEX
    ]


DATA_END = encode(DataEnd(0))
