# SPDX-License-Identifier: Apache-2.0
"""Recordings with pictures beside their packets, which viewers of MCAP show.

A recording has one channel, whose packets describe themselves: viewers list it and show nothing.
A copy with derived channels has the same bytes up to the end of the packets, so that it is still a
recording, and behind them a chunk for each picture, with the message types of Foxglove.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    MetadataIndex,
    Schema,
    Statistics,
)

from hueflight.calibration import Calibration
from hueflight.errors import ExportError
from hueflight.export.description import describe
from hueflight.export.foxglove_messages import FoxgloveMessages, Topic
from hueflight.files import staged
from hueflight.ingest.accumulator import Counts
from hueflight.reconstruction import reconstruct
from hueflight.reconstruction.sums.recorded import reconstruct_recorded_sums
from hueflight.recording import SumsReader, holds_recorded_sums, open_recording
from hueflight.recording.layout import CHANNEL, segment_files, segment_path
from hueflight.recording.reader import Recording
from hueflight.recording.records import (
    DATA_END,
    FOOTER_BYTES,
    MAGIC,
    RECORD_HEAD,
    decode,
    encode,
    encode_summary,
    walk,
)
from hueflight.recording.segment_reader import SegmentReader

FRAMES = 480  #: behind each picture, unless another number is asked for


def add_foxglove_channels(
    recording: str | Path,
    path: str | Path,
    calibration: Calibration,
    /,
    *,
    every: int | None = None,
    frames: int = FRAMES,
    enrich: Callable[[xr.Dataset], xr.Dataset] = lambda image: image,
    overwrite: bool = False,
) -> None:
    """Copy a recording and add pictures that Foxglove shows, on channels of their own.

    The packets and the index of the copy are those of the recording, byte for byte, so that
    `hueflight.open_recording` opens it as before.

    Parameters
    ----------
    recording : str or pathlib.Path
        The recording.
    path : str or pathlib.Path
        Name of the copy; it has as many files as the recording.
    calibration : Calibration
        Calibration with which the pictures are reconstructed.
    every : int, optional
        Frames from one picture to the next; by default as many as are behind each. In a recording
        of sums, both numbers are rounded up to those of whole pictures of sums.
    frames : int
        Frames behind each picture, the newest ones at its time.
    enrich : callable
        Returns each image with further planes, such as `hueflight.analysis.add_materials`.
    overwrite : bool
        Whether an existing file of this name may be replaced.

    Raises
    ------
    ExportError
        If a number of frames is not positive, or the recording is shorter than one picture.
    RecordingError
        If the recording can't be read, or is of another instrument than the calibration.
    MissingPackageError
        If the package foxglove-sdk is not installed.
    OutputError
        If the file exists already or can't be written.
    """
    step = frames if every is None else every
    for name, value in (("frames", frames), ("every", step)):
        if value < 1:
            raise ExportError(f"{name} = {value}: must be 1 or more")
    source, target = Path(recording), Path(path)
    with open_recording(source) as opened, staged(target, overwrite=overwrite) as partial:
        calibration.require(opened.instrument)
        sums = _sums_of(opened)
        held = opened.frames if sums is None else sums.pictures * sums.picture_frames
        if held < frames:
            raise ExportError(f"{source} has {held} frames: fewer than the {frames} of one picture")
        made = FoxgloveMessages(opened.instrument)
        for number, file in enumerate(segment_files(source)[0]):
            segment = SegmentReader(file)
            try:
                pictures = (
                    (time_ns, _topics(made, enrich(image), time_ns))
                    for time_ns, image in (
                        _pictures(opened, segment, calibration, step, frames)
                        if sums is None
                        else _pictures_of_sums(opened, sums, number, calibration, step, frames)
                    )
                )
                segment_path(partial, number).write_bytes(_with_pictures(segment, pictures))
            finally:
                segment.close()


def _pictures(
    recording: Recording,
    segment: SegmentReader,
    calibration: Calibration,
    step: int,
    frames: int,
) -> Iterator[tuple[int, xr.Dataset]]:
    """Time and image of the pictures whose newest frame is in a segment."""
    first = int(segment.index["first"][0]) if len(segment.index) else 0
    stop = first + int(segment.index["frames"].sum())
    begin = frames + step * max(0, -(-(first + 1 - frames) // step))
    for end in range(begin, stop + 1, step):
        histogram: Counts = recording.histogram(end - frames, end)
        image = describe(reconstruct(histogram, calibration), calibration)
        chunk = int(np.searchsorted(segment.index["first"], end - 1, side="right")) - 1
        yield int(segment.index["log_time"][chunk]), image


def _sums_of(recording: Recording) -> SumsReader | None:
    """The pictures of a recording that holds sums and no codes."""
    if recording.frames or not holds_recorded_sums(recording):
        return None
    return SumsReader(recording)


def _pictures_of_sums(
    recording: Recording,
    sums: SumsReader,
    segment: int,
    calibration: Calibration,
    step: int,
    frames: int,
) -> Iterator[tuple[int, xr.Dataset]]:
    """The same of a recording of sums, from as many whole pictures of sums as hold the frames."""
    together, apart = (-(-number // sums.picture_frames) for number in (frames, step))
    for end in range(together, sums.pictures + 1, apart):
        chunk = sums.chunk_of(end - 1)
        if recording.segment_of(chunk) != segment:
            continue
        added = sums.read(end - together, end)
        if added.pictures:
            image = describe(reconstruct_recorded_sums(added, calibration), calibration)
            yield int(recording.chunks["log_time"][chunk]), image


def _topics(made: FoxgloveMessages, image: xr.Dataset, time_ns: int) -> dict[str, Topic]:
    topics = made.topics(image, time_ns=time_ns)
    topics["/log"] = made.summary(image, time_ns=time_ns)
    return topics


def _with_pictures(
    segment: SegmentReader, pictures: Iterator[tuple[int, dict[str, Topic]]]
) -> bytes:
    """The bytes of a segment with chunks of pictures behind its packets."""
    end = segment.size - FOOTER_BYTES - len(MAGIC)
    footer = decode(Footer, segment.read(end + RECORD_HEAD.size, FOOTER_BYTES - RECORD_HEAD.size))
    kept = segment.read(0, footer.summary_start - len(DATA_END))
    summary = segment.read(footer.summary_start, end - footer.summary_start)
    [statistics] = _records(summary, Opcode.STATISTICS, Statistics)
    chunks = _records(summary, Opcode.CHUNK_INDEX, ChunkIndex)
    output = BytesIO()
    output.write(kept)
    schemas: dict[str, Schema] = {}
    channels: dict[str, Channel] = {}
    counts = dict(statistics.channel_message_counts)
    for time_ns, topics in pictures:
        index, content = _chunk(output.tell(), time_ns, topics, schemas, channels, counts)
        output.write(content)
        chunks.append(index)
        statistics.message_count += len(topics)
    statistics.channel_message_counts = counts
    statistics.schema_count, statistics.channel_count = len(schemas), 1 + len(channels)
    statistics.chunk_count = len(chunks)
    if chunks:
        statistics.message_start_time = min(each.message_start_time for each in chunks)
        statistics.message_end_time = max(each.message_end_time for each in chunks)
    output.write(DATA_END)
    output.write(
        encode_summary(
            output.tell(),
            CHANNEL,
            statistics,
            chunks,
            _records(summary, Opcode.ATTACHMENT_INDEX, AttachmentIndex),
            _records(summary, Opcode.METADATA_INDEX, MetadataIndex),
            schemas=list(schemas.values()),
            channels=list(channels.values()),
        )
    )
    return output.getvalue()


def _chunk(
    start: int,
    time_ns: int,
    topics: dict[str, Topic],
    schemas: dict[str, Schema],
    channels: dict[str, Channel],
    counts: dict[int, int],
) -> tuple[ChunkIndex, bytes]:
    """The chunk of one picture at byte `start` of the file, and its entry in the summary."""
    records = b""
    places: dict[int, int] = {}
    for name, topic in topics.items():
        message = topic.build()
        if name not in channels:
            schema = _schema_of(message, topic.schema, schemas)
            # that of the packets is 1
            channels[name] = Channel(
                id=CHANNEL.id + 1 + len(channels),
                topic=name,
                message_encoding="protobuf",
                metadata={},
                schema_id=schema.id,
            )
            records += encode(schema, channels[name])
        number = channels[name].id
        places[number] = len(records)
        sequence = counts.get(number, 0)
        records += encode(
            Message(
                channel_id=number,
                log_time=time_ns,
                data=message.encode(),
                publish_time=time_ns,
                sequence=sequence,
            )
        )
        counts[number] = sequence + 1
    chunk = encode(
        Chunk(
            compression="",
            data=records,
            message_end_time=time_ns,
            message_start_time=time_ns,
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=len(records),
        )
    )
    indexes, offsets = b"", {}
    for number, place in places.items():
        offsets[number] = start + len(chunk) + len(indexes)
        indexes += encode(MessageIndex(number, [(time_ns, place)]))
    entry = ChunkIndex(
        chunk_length=len(chunk),
        chunk_start_offset=start,
        compression="",
        compressed_size=len(records),
        message_end_time=time_ns,
        message_index_length=len(indexes),
        message_index_offsets=offsets,
        message_start_time=time_ns,
        uncompressed_size=len(records),
    )
    return entry, chunk + indexes


def _schema_of(message: Any, kind: str, schemas: dict[str, Schema]) -> Schema:
    if kind not in schemas:
        known = message.get_schema()
        schemas[kind] = Schema(
            id=len(schemas) + 1, name=known.name, encoding=known.encoding, data=known.data
        )
    return schemas[kind]


def _records(summary: bytes, opcode: Opcode, kind: type[McapRecord]) -> list[Any]:
    """The records of one kind in a summary."""
    return [
        decode(kind, summary[at + RECORD_HEAD.size : at + size])
        for found, at, size in walk(lambda at, n: summary[at : at + n], 0, len(summary))
        if found == opcode
    ]
