# SPDX-License-Identifier: Apache-2.0
"""The rules by which the program ``mcap doctor`` finds errors in a file, checked record by record.

Its warnings are no errors: a profile that is not well known, and messages that are not in the order
of time, which pictures behind the packets of a recording are not.
"""

from __future__ import annotations

import zlib
from collections import Counter
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    MessageIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader


class Diagnosis:
    """Errors of a file; `errors` is empty if it is well."""

    def __init__(self, path: Path) -> None:
        self.errors: list[str] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._summary: set[int] = set()
        self._chunks: dict[int, tuple[Chunk, int, set[int]]] = {}
        self._indexed: dict[int, ChunkIndex] = {}
        self._counts: Counter[int] = Counter()
        self._times: list[int] = []
        self._latest: tuple[int, Chunk] | None = None
        self._message_indexes: dict[int, MessageIndex] = {}
        self._statistics: list[Statistics] = []
        self._ended = self._footed = False
        with path.open("rb") as stream:
            reader = StreamReader(stream, emit_chunks=True, validate_crcs=True)
            place = 8  # behind the magic
            for record in reader.records:
                self._take(record, place)
                place = stream.tell()
        self._finish()

    def _take(self, record: Any, place: int) -> None:
        if not isinstance(record, MessageIndex):
            self._examine_chunk()
        match record:
            case Schema():
                self._schema(record)
            case Channel():
                self._channel(record)
            case Chunk():
                self._latest, self._message_indexes = (place, record), {}
            case MessageIndex():
                if self._latest is None:
                    self.errors.append("a message index without a chunk before it")
                self._message_indexes[record.channel_id] = record
            case ChunkIndex():
                if record.chunk_start_offset in self._indexed:
                    self.errors.append(f"two indexes of the chunk at {record.chunk_start_offset}")
                self._indexed[record.chunk_start_offset] = record
            case Statistics():
                self._statistics.append(record)
            case DataEnd():
                self._ended = True
            case Footer():
                self._footed = True
            case _:
                pass

    def _schema(self, record: Schema) -> None:
        if record.id == 0 or (not record.encoding and record.data):
            self.errors.append(f"schema {record.id} {record.name!r} is invalid")
        if self._schemas.setdefault(record.id, record) != record:
            self.errors.append(f"two different schemas have number {record.id}")

    def _channel(self, record: Channel) -> None:
        if self._ended:
            self._summary.add(record.id)
            if record.id not in self._channels:
                self.errors.append(f"channel {record.id} is in the summary alone")
        if self._channels.setdefault(record.id, record) != record:
            self.errors.append(f"two different channels have number {record.id}")
        if record.schema_id and record.schema_id not in self._schemas:
            self.errors.append(f"channel {record.id} comes before its schema {record.schema_id}")

    def _examine_chunk(self) -> None:
        if self._latest is None:
            return
        place, chunk = self._latest
        self._latest = None
        if chunk.compression or len(chunk.data) != chunk.uncompressed_size:
            self.errors.append(f"chunk at {place}: its size is wrong, or it is compressed")
        if chunk.uncompressed_crc and zlib.crc32(chunk.data) != chunk.uncompressed_crc:
            self.errors.append(f"chunk at {place}: its checksum is wrong")
        times, referenced = [], set()
        for offset, record in _records_of(chunk):
            match record:
                case Schema():
                    self._schema(record)
                case Channel():
                    self._channel(record)
                case Message():
                    times.append(record.log_time)
                    referenced.add(record.channel_id)
                    self._counts[record.channel_id] += 1
                    self._check_message(record, offset)
        if times and (min(times), max(times)) != (chunk.message_start_time, chunk.message_end_time):
            self.errors.append(f"chunk at {place}: its times are not those of its messages")
        self._times += times
        self._chunks[place] = chunk, len(times), referenced

    def _check_message(self, message: Message, offset: int) -> None:
        if message.channel_id not in self._channels:
            self.errors.append(f"a message comes before its channel {message.channel_id}")
        index = self._message_indexes.get(message.channel_id)
        if index is None or (message.log_time, offset) not in index.records:
            self.errors.append(f"a message of channel {message.channel_id} is not in the index")

    def _finish(self) -> None:
        if not (self._ended and self._footed):
            self.errors.append("the file has no end of data, or no footer")
        if self._indexed.keys() != self._chunks.keys():
            self.errors.append("the chunks of the index are not those of the file")
        for place, index in self._indexed.items():
            chunk, _, referenced = self._chunks.get(place, (None, 0, set()))
            if chunk is None:
                continue
            stated = (index.message_start_time, index.message_end_time, index.uncompressed_size)
            found = (chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size)
            if stated != found or index.message_index_offsets.keys() != referenced:
                self.errors.append(f"the index of the chunk at {place} contradicts it")
            if not referenced <= self._summary:
                self.errors.append(f"channels of the chunk at {place} are not in the summary")
        if len(self._statistics) != 1:
            self.errors.append(f"{len(self._statistics)} records of statistics")
            return
        [told] = self._statistics
        pairs = {
            "messages": (told.message_count, sum(self._counts.values())),
            "messages by channel": (dict(told.channel_message_counts), dict(self._counts)),
            "schemas": (told.schema_count, len(self._schemas)),
            "channels": (told.channel_count, len(self._channels)),
            "chunks": (told.chunk_count, len(self._chunks)),
            "first time": (told.message_start_time, min(self._times, default=0)),
            "last time": (told.message_end_time, max(self._times, default=0)),
        }
        for name, (stated, counted) in pairs.items():
            if stated != counted:
                self.errors.append(f"statistics of {name}: {stated} stated, {counted} counted")


def _records_of(chunk: Chunk) -> list[tuple[int, Any]]:
    """Records of an uncompressed chunk with their places in it."""
    from io import BytesIO

    stream, found = BytesIO(chunk.data), []
    kinds = {3: Schema, 4: Channel, 5: Message}
    while (place := stream.tell()) < len(chunk.data):
        data = ReadDataStream(stream)
        opcode, size = data.read1(), data.read8()
        inner = ReadDataStream(BytesIO(data.read(size)))
        found.append(
            (place, Message.read(inner, size) if opcode == 5 else kinds[opcode].read(inner))
        )
    return found
