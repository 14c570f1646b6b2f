# SPDX-License-Identifier: Apache-2.0
"""Recovery of all intact packets from damaged or unfinished recordings."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Header, MessageIndex, Metadata

from hueflight.errors import InstrumentError, RecordingError, RecordingNotFoundError
from hueflight.files.descriptors import open_to_read, read_at
from hueflight.ingest.buffer import PacketBuffer, pieces
from hueflight.ingest.kernels import Kernels, choose
from hueflight.model.instrument import Instrument, Sensor
from hueflight.recording.layout import (
    DESCRIPTION,
    INSTRUMENT,
    OWN_NAMES,
    PART,
    Description,
    part_path,
    segment_files,
    split_segment_path,
)
from hueflight.recording.records import (
    MAGIC,
    PAYLOAD_OFFSET,
    RECORD_HEAD,
    decode,
    decode_attachment,
    decode_chunk,
    walk,
)
from hueflight.recording.segment_reader import SegmentReader
from hueflight.recording.writer import RecordingWriter

PIECE_BYTES = 4 << 20
SECTOR_BYTES = 4096
MOST_RECORD_BYTES = 1 << 30
_SMALL = {
    Opcode.HEADER: Header,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.DATA_END: DataEnd,
}


class Outcome(IntEnum):
    """Outcome of a recovery; the numbers are exit codes of ``hueflight recover``.

    Attributes
    ----------
    WHOLE : int
        Nothing was lost.
    NOTHING : int
        There was no intact packet.
    LOSSY : int
        Some packets were lost.
    """

    WHOLE = 0
    NOTHING = 1
    LOSSY = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """Result of a recovery.

    Parameters
    ----------
    outcome : Outcome
        WHOLE if every byte of every file was in its place and no file is missing, whether or not
        the last one was finished; NOTHING if there was no intact packet; LOSSY otherwise.
    path : Path or None
        The new recording; None if there was nothing to save.
    files : tuple of str
        Files that were read.
    frames : int
        Frames in the new recording.
    damaged_bytes : int
        Bytes that belong to no intact record. Packets among them that are intact themselves are
        kept.
    missing_segments : int
        Segments between others, or after the last one, that do not exist.
    unfinished : int
        Files that were not finished.
    cut : int
        Files that were finished and have lost their end.
    """

    outcome: Outcome
    path: Path | None
    files: tuple[str, ...]
    frames: int
    damaged_bytes: int
    missing_segments: int
    unfinished: int
    cut: int

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a dictionary, ready for JSON.

        Returns
        -------
        dict
            Results by name.
        """
        path = None if self.path is None else str(self.path)
        return asdict(self) | {"outcome": self.outcome.name.lower(), "path": path}


@dataclass(slots=True)
class Examined:
    """What is intact in one file.

    Attributes
    ----------
    path : Path
        The file.
    size : int
        Its bytes.
    attachments : dict of bytes
        Intact attachments by name.
    description : Description or None
        Identity of the recording; None if it is lost.
    stream : list of tuple of (int, int)
        Place and size of what holds packets, in order.
    damaged_bytes : int
        Bytes that belong to no intact record.
    cut : bool
        True if the file has the name of a finished one, and no end.
    last : bool
        True unless something says that there must be a segment behind it.
    """

    path: Path
    size: int = 0
    attachments: dict[str, bytes] = field(default_factory=dict)
    description: Description | None = None
    stream: list[tuple[int, int]] = field(default_factory=list)
    damaged_bytes: int = 0
    cut: bool = False
    last: bool = True


def recover(
    path: str | Path,
    out: str | Path | None = None,
    /,
    *,
    instrument: Instrument | None = None,
    overwrite: bool = False,
    kernels: Kernels | None = None,
) -> Recovery:
    """Write all intact packets of a recording into a new one, and leave the old files as they are.

    Chunks with a correct CRC are copied. Damaged stretches are copied too: each packet has a CRC of
    its own, so that readers count the packets in them that are intact, and no others.

    Parameters
    ----------
    path : str or Path
        Path of the recording's first file, such as ``run.mcap``.
    out : str or Path, optional
        Path of the new recording, by default ``run.recovered.mcap``.
    instrument : Instrument, optional
        Instrument that is used if no file states it any more.
    overwrite : bool
        Replace a recording at `out`.
    kernels : Kernels, optional
        Kernels that scan packets; by default the fastest available.

    Returns
    -------
    Recovery
        Outcome, and counts of what was saved and lost.

    Raises
    ------
    RecordingError
        If there are no files, they belong to several recordings, none states the instrument, or the
        new recording can't be written.
    """
    path = Path(path)
    out = path.with_suffix(f".recovered{path.suffix}") if out is None else Path(out)
    files = _files(path)
    found = [examine(file) for file in files.values()]
    described = instrument or stated_instrument(found)
    if described is None:
        if any(_has_packets(each) for each in found):
            raise RecordingError(
                f"{path}: none of its files states the instrument any more: name the instrument"
            )
        return _recovery(Outcome.NOTHING, files, found)
    known = [each.description for each in found if each.description is not None]
    if len({each.recording for each in known}) > 1:
        raise RecordingError(
            f"{path}: its files belong to several recordings: move some to another folder"
        )
    attachments: dict[str, bytes] = {}
    for each in reversed(found):
        attachments |= each.attachments
    with RecordingWriter(
        out,
        described,
        metadata=known[0].metadata if known else None,
        attachments={name: attachments[name] for name in attachments if name not in OWN_NAMES},
        overwrite=overwrite,
        kernels=kernels,
    ) as writer:
        for each in found:
            for piece in stream(each):
                writer.write(piece)
    if not writer.report.packets:
        for file in segment_files(out)[0]:
            file.unlink()
        return _recovery(Outcome.NOTHING, files, found)
    return _recovery(Outcome.WHOLE, files, found, path=out, frames=writer.frames)


def check_recording(path: str | Path, /) -> Recovery:
    """Read all files of a recording and compare them with their checksums; nothing is written.

    Parameters
    ----------
    path : str or Path
        Path of the recording's first file.

    Returns
    -------
    Recovery
        What is damaged or missing, without a new recording.

    Raises
    ------
    RecordingError
        If there are no files, or they can't be read.
    """
    files = _files(Path(path))
    return _recovery(Outcome.WHOLE, files, [examine(file) for file in files.values()])


def _recovery(
    outcome: Outcome,
    files: dict[int, Path],
    found: list[Examined],
    *,
    path: Path | None = None,
    frames: int = 0,
) -> Recovery:
    damaged = sum(each.damaged_bytes for each in found)
    missing = max(files) + 1 - len(files) + (not found[-1].last)
    cut = sum(each.cut for each in found)
    if outcome == Outcome.WHOLE and (damaged or missing or cut):
        outcome = Outcome.LOSSY
    return Recovery(
        outcome=outcome,
        path=path,
        files=tuple(str(file) for file in files.values()),
        frames=frames,
        damaged_bytes=damaged,
        missing_segments=missing,
        unfinished=sum(file.suffix == PART for file in files.values()),
        cut=cut,
    )


def _files(path: Path) -> dict[int, Path]:
    """All files of a recording, finished or not, by the number of the segment."""
    finished, unfinished = segment_files(path)
    # a finished file comes last, so that it replaces an unfinished one of the same number
    files = {
        0 if file in (path, part_path(path)) else split_segment_path(file)[1]: file
        for file in (*unfinished, *finished)
    }
    if not files:
        raise RecordingNotFoundError(
            f"there is no recording {str(path)!r}, not even an unfinished one"
        )
    return dict(sorted(files.items()))


class _Disk:
    """A file on a disk that may have bad sectors: those read as zeros."""

    def __init__(self, path: Path) -> None:
        try:
            self._fd = open_to_read(path)
        except OSError as error:
            raise RecordingError(f"can't read {path}: {error.strerror or error}") from None
        self.size = os.fstat(self._fd).st_size

    def __enter__(self) -> _Disk:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    def read(self, at: int, size: int) -> bytes:
        """Bytes of the file; fewer at its end."""
        with suppress(OSError):
            return read_at(self._fd, size, at)
        borders = range(at - at % SECTOR_BYTES + SECTOR_BYTES, at + size, SECTOR_BYTES)
        return b"".join(self._read_sector(a, b) for a, b in pairwise([at, *borders, at + size]))

    def _read_sector(self, start: int, stop: int) -> bytes:
        try:
            return read_at(self._fd, stop - start, start)
        except OSError:
            return bytes(stop - start)


def examine(path: Path, /) -> Examined:
    """Go through a file's records, and note the stream and what is damaged.

    Parameters
    ----------
    path : Path
        A file of a recording, finished or not.

    Returns
    -------
    Examined
        What is intact in it.

    Raises
    ------
    RecordingError
        If it can't be opened.
    """
    with _Disk(path) as disk:
        found = Examined(path, disk.size)
        at = len(MAGIC) if disk.read(0, len(MAGIC)) == MAGIC else 0
        found.damaged_bytes += 0 if at else min(len(MAGIC), disk.size)
        ended = False
        for opcode, start, size in walk(disk.read, at or len(MAGIC), disk.size):
            intact = size <= MOST_RECORD_BYTES and _take(found, disk, opcode, start, size)
            if not intact:
                if not _plausible(disk, start + size):
                    break
                # whatever it was, it may hold packets
                found.damaged_bytes += size
                found.stream.append((start, size))
            at = start + size
            if intact and opcode == Opcode.DATA_END:
                ended = True
                break
        # a file that stops right behind the stream has lost its index, and with it its end
        ended = ended and at < disk.size
        if ended:
            found.last = _read_end(found, disk.size - at)
        elif at < disk.size:
            found.damaged_bytes += disk.size - at
            found.stream.append((at, disk.size - at))
        found.cut = not ended and path.suffix != PART
        return found


def _read_end(found: Examined, size: int) -> bool:
    """Check summary and index, the last `size` bytes; return whether no file must follow."""
    try:
        reader = SegmentReader(found.path)
    except RecordingError:
        found.damaged_bytes += size
        return True
    reader.close()
    return reader.closing.last


def _take(found: Examined, disk: _Disk, opcode: int, start: int, size: int) -> bool:
    """Note what is in a record; return False if it is damaged or not one of ours."""
    record = disk.read(start, size)
    if opcode == Opcode.CHUNK:
        if decode_chunk(memoryview(record)) is None:
            return False
        found.stream.append((start + PAYLOAD_OFFSET, size - PAYLOAD_OFFSET))
        return True
    try:
        if opcode == Opcode.ATTACHMENT:
            attachment = decode_attachment(record)
            if attachment.name == DESCRIPTION:
                found.description = msgspec.json.decode(attachment.data, type=Description)
            found.attachments[attachment.name] = attachment.data
        elif opcode in _SMALL:
            decode(_SMALL[Opcode(opcode)], record[RECORD_HEAD.size :])
        else:
            return False
    except (RecordingError, msgspec.DecodeError):
        return False
    return True


def _plausible(disk: _Disk, at: int) -> bool:
    """Whether a record may begin here: then the length of the one before it was right."""
    if at == disk.size:
        return True
    head = disk.read(at, RECORD_HEAD.size).ljust(RECORD_HEAD.size, b"\0")
    opcode, length = RECORD_HEAD.unpack(head)
    known = {Opcode.CHUNK, Opcode.ATTACHMENT, *_SMALL}
    return opcode in known and at + RECORD_HEAD.size + length <= disk.size


def stream(found: Examined, /) -> Iterator[bytes]:
    """Return the bytes of the camera's stream in a file, in pieces.

    Parameters
    ----------
    found : Examined
        What is intact in the file.

    Yields
    ------
    bytes
        A piece; sectors that can't be read are zeros.
    """
    with _Disk(found.path) as disk:
        for start, size in found.stream:
            for at in range(start, start + size, PIECE_BYTES):
                yield disk.read(at, min(PIECE_BYTES, start + size - at))


def stated_instrument(found: list[Examined], /) -> Instrument | None:
    """Return the instrument that the first file states for which this is intact.

    Parameters
    ----------
    found : list of Examined
        What is intact in each file.

    Returns
    -------
    Instrument or None
        None if no file states it any more.
    """
    for each in found:
        if INSTRUMENT in each.attachments:
            with suppress(InstrumentError):
                return Instrument.from_json(each.attachments[INSTRUMENT], where=str(each.path))
    return None


def _has_packets(found: Examined) -> bool:
    """Whether there is an intact packet of any sensor."""
    buffer = PacketBuffer(Sensor(rows=1, cols=1, code_bits=1, bin_width_ns=1), choose())
    for piece in stream(found):
        for _ in pieces(buffer, piece):
            buffer.scan(limit=1)
            buffer.release()
    return bool(buffer.scanner.total("packets"))
