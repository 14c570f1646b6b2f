# SPDX-License-Identifier: Apache-2.0
"""Writing recordings: raw packets as received, safe against crashes and full or slow disks."""

from __future__ import annotations

import time
import uuid
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType

import msgspec

from hueflight.errors import RecordingError
from hueflight.files import describe_existing
from hueflight.ingest import kernels as backends
from hueflight.ingest.buffer import PacketBuffer, pieces
from hueflight.ingest.kernels import STATE, Kernels
from hueflight.ingest.picture_totals import PictureTotals, holds_sums
from hueflight.ingest.report import IngestReport
from hueflight.model.instrument import Instrument
from hueflight.recording.background import Background, Job
from hueflight.recording.layout import (
    FORMAT,
    OWN_NAMES,
    PART,
    SUFFIX,
    Description,
    part_path,
    segment_files,
    segment_path,
)
from hueflight.recording.segment import FAILURES, Segment

CHUNK_BYTES = 1 << 20
SEGMENT_BYTES = 256 << 20
SETTLE_BYTES = 16 << 20
FLUSH_SECONDS = 1.0
FRAMES_AT_HAND = 4096
_SEQUENCE, _HAS_SEQUENCE = STATE.index("sequence"), STATE.index("has_sequence")


class RecordingWriter:
    """Writes the camera's stream into a recording.

    Packets are stored exactly as received, including damaged ones and bytes between packets. Data
    that `write` and `flush` have put into a file survives a crash of the program. A power cut
    destroys what has not reached the disk: about the last 32 MiB on a disk that keeps up, and never
    a finished segment.

    Parameters
    ----------
    path : str or Path
        Path of the first file, which ends in ``.mcap``; further segments are called
        ``name.000001.mcap`` and so on. The name of a file ends in ``.part`` until it is finished.
    instrument : Instrument
        Instrument, which states the layout of frames and is stored in each segment.
    metadata : mapping, optional
        Notes about the capture; values are stored as text.
    attachments : mapping of bytes, optional
        Files to keep with the packets by name, such as a calibration.
    segment_bytes : int
        Size at which a segment is finished, in the background, and the next one begins.
    segment_seconds : float, optional
        Age at which a segment is finished; by default there is no limit.
    chunk_bytes : int
        Packets are put into the file when there are this many bytes of them.
    flush_seconds : float
        Packets are put into the file when they have waited this long.
    settle_bytes : int
        Bytes that are written between waits for the disk, which happen in the background.
    overwrite : bool
        Replace a recording of the same name.
    kernels : Kernels, optional
        Kernels that scan packets; by default the fastest available.

    Attributes
    ----------
    frames : int
        Frames that are safe in a file.
    size : int
        Bytes of packets that are safe in a file.
    lost_frames : int
        Frames that arrived after writing had failed.
    lost_bytes : int
        Bytes of packets that arrived after writing had failed.
    picture_frames, lost_picture_frames : int
        The same for frames behind pictures of sums of which every packet came.
    error : RecordingError or None
        Reason why writing failed.

    Raises
    ------
    RecordingError
        If the file can't be made, it exists, or it is left from a recording that did not end.
    """

    def __init__(
        self,
        path: str | Path,
        instrument: Instrument,
        /,
        *,
        metadata: Mapping[str, object] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        segment_bytes: int = SEGMENT_BYTES,
        segment_seconds: float | None = None,
        chunk_bytes: int = CHUNK_BYTES,
        flush_seconds: float = FLUSH_SECONDS,
        settle_bytes: int = SETTLE_BYTES,
        overwrite: bool = False,
        kernels: Kernels | None = None,
    ) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() != SUFFIX:
            raise RecordingError(f"{self.path}: the name of a recording must end in {SUFFIX}")
        own = [name for name in attachments or {} if name in OWN_NAMES]
        if own:
            raise RecordingError(f"attachment {own[0]!r}: the name is reserved, choose another one")
        if min(segment_bytes, chunk_bytes, settle_bytes) < 1:
            raise RecordingError("segment_bytes, chunk_bytes and settle_bytes must be at least 1")
        self.frames = self.size = 0
        self.lost_frames = self.lost_bytes = 0
        self.picture_frames = self.lost_picture_frames = 0
        self._pictures = PictureTotals()
        self.error: RecordingError | None = None
        self._segment_bytes, self._segment_seconds = segment_bytes, segment_seconds
        self._chunk_bytes, self._flush_seconds = chunk_bytes, flush_seconds
        self._settle_bytes = settle_bytes
        self._instrument_json = instrument.to_json()
        self._attachments = dict(attachments or {})
        self._description = Description(
            format=FORMAT,
            recording=uuid.uuid4().hex,
            segment=0,
            started=datetime.now(UTC).isoformat(timespec="milliseconds"),
            metadata={str(key): str(value) for key, value in (metadata or {}).items()},
        )
        self._buffer = PacketBuffer(
            instrument.sensor, kernels or backends.choose(), limit=FRAMES_AT_HAND
        )
        self._sequence = (0, 0)  # of the last packet that was stored, and whether there was one
        self._waiting_since: float | None = None
        self._segments = 0
        self._told = True
        self._closed = False
        self._disk = Background("disk")
        self._finishing: Job | None = None
        self._settling: Job | None = None
        self._refuse_leftovers(overwrite)
        try:
            self._segment: Segment | None = self._start_segment()
        except FAILURES as error:
            raise RecordingError(f"can't start {self.path}: {reason_of(error)}") from error

    # -- public interface --------------------------------------------------------------------------

    @property
    def report(self) -> IngestReport:
        """Totals of the stream, stored or not."""
        state = self._buffer.scanner.state
        return IngestReport.from_state(state, photons=int(state[STATE.index("hits")]))

    def write(self, *packets: bytes | bytearray | memoryview) -> None:
        """Take the next bytes of the stream.

        Parameters
        ----------
        *packets : bytes-like
            Consecutive pieces of any size, cut anywhere.

        Raises
        ------
        RecordingError
            Once, when writing fails: data in the file is kept, and later data counts as lost until
            `resume`. Also if the recording is closed.
        """
        if self._closed:
            raise RecordingError(f"{self.path}: the recording is closed")
        for _ in pieces(self._buffer, *packets):
            self._advance(final=False)
        if self._waiting_since is None:
            self._waiting_since = time.monotonic()
        elif time.monotonic() - self._waiting_since > self._flush_seconds:
            self._store()
        self._tell()

    def flush(self) -> None:
        """Put all whole packets into the file now.

        Raises
        ------
        RecordingError
            As for `write`.
        """
        self._store()
        self._tell()

    def suspend(self, reason: str, /) -> None:
        """Put all whole packets into the file, finish it, and write nothing more until `resume`.

        Later data counts as lost, as after a failure.

        Parameters
        ----------
        reason : str
            Why nothing may be written, which `error` says from now on.

        Raises
        ------
        RecordingError
            If the packets can't be put into the file.
        """
        if self.error is not None or self._closed:
            return
        self._store()
        self._finish_segment(last=True)
        self._tell()
        self.error = RecordingError(reason)
        self._told = True

    def resume(self) -> None:
        """Continue in a new segment after a failure, when the disk has space again.

        Raises
        ------
        RecordingError
            If the new segment can't be made.
        """
        if self.error is None or self._closed:
            return
        try:
            self._segment = self._start_segment()
        except FAILURES as error:
            raise RecordingError(f"can't continue {self.path}: {reason_of(error)}") from error
        self.error = None

    def close(self) -> None:
        """Store what is left, finish the last segment and wait for the disk.

        Raises
        ------
        RecordingError
            If that fails; packets in the files can be saved with `recover`.
        """
        if self._closed:
            return
        self._closed = True
        try:
            try:
                self._advance(final=True)
            except MemoryError as error:
                self._fail(error)
            self._finish_segment(last=True)
            self._wait_for_disk()
            self._tell()
        finally:
            self._disk.close()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # -- chunks ------------------------------------------------------------------------------------

    def _advance(self, *, final: bool) -> None:
        buffer = self._buffer
        while True:
            ended = buffer.scan(limit=FRAMES_AT_HAND, final=final)
            for packet in filter(holds_sums, buffer.others):
                self._pictures.feed(packet)
            buffer.others.clear()  # they are in the stream anyway
            if not ended or final or buffer.tight or len(buffer.complete) >= self._chunk_bytes:
                self._store()
            if ended:
                return

    def _store(self) -> None:
        """Append the whole packets at hand to the file as one chunk."""
        payload, frames = self._buffer.complete, self._buffer.scanner.frames
        if not payload:
            return
        # What needs memory comes first: packets that are stored must be counted and given up
        state = self._buffer.scanner.state
        sequence = (int(state[_SEQUENCE]), int(state[_HAS_SEQUENCE]))
        stored = (self.frames + frames, self.size + len(payload))
        lost = (self.lost_frames + frames, self.lost_bytes + len(payload))
        in_pictures = self._pictures.frames - self.picture_frames - self.lost_picture_frames
        if self._appended(payload):
            self.frames, self.size = stored
            self.picture_frames += in_pictures
        else:
            self.lost_frames, self.lost_bytes = lost
            self.lost_picture_frames += in_pictures
            self._pictures.interrupt()
        self._sequence = sequence
        self._buffer.release()
        self._waiting_since = None
        self._settle()
        self._rotate()

    def _appended(self, payload: memoryview) -> bool:
        """Append packets to the segment, if there is one; return whether they are in the file."""
        if self._segment is None:
            if self.error is None:  # an error of another kind kept a segment from being started
                self.error = RecordingError(f"{self.path}: there is no file to write to")
                self._told = False
            return False
        try:
            self._append(self._segment, payload)
        except FAILURES as error:
            self._fail(error)
            return False
        return True

    def _append(self, segment: Segment, payload: memoryview) -> None:
        scanner = self._buffer.scanner
        first = scanner.header_fields()[0] if scanner.frames else None
        segment.append_chunk(
            payload,
            frames=scanner.frames,
            log_time=time.time_ns(),
            tick=0 if first is None else int(first["timestamp"]),
            clock_hz=0 if first is None else int(first["clock_hz"]),
            sequence=self._sequence[0],
            has_sequence=self._sequence[1],
        )

    def _settle(self) -> None:
        """Start to flush written data to the disk, unless an earlier flush is in progress."""
        segment, settling = self._segment, self._settling
        try:
            if settling is not None:
                if not settling.done:
                    return
                self._settling = None
                settling.result()
            if segment is not None and segment.size - segment.settled >= self._settle_bytes:
                self._settling = self._disk.submit(segment.settle)
        except FAILURES as error:
            self._fail(error)

    def _tell(self) -> None:
        """Raise a failure that has not been reported yet."""
        if self.error is not None and not self._told:
            self._told = True
            raise self.error

    # -- segments ----------------------------------------------------------------------------------

    def _rotate(self) -> None:
        segment = self._segment
        if segment is None or self._closed:
            return
        age = time.monotonic() - segment.started
        if segment.size >= self._segment_bytes or age >= (self._segment_seconds or float("inf")):
            self._finish_segment(last=False)
            try:
                self._segment = self._start_segment() if self.error is None else None
            except FAILURES as error:
                self._fail(error)

    def _start_segment(self) -> Segment:
        number = self._segments
        path = segment_path(self.path, number)
        if number == 0:
            path.parent.mkdir(parents=True, exist_ok=True)
        else:  # left from an attempt that failed
            part_path(path).unlink(missing_ok=True)
        description = msgspec.structs.replace(self._description, segment=number)
        segment = Segment(
            path, description, self._instrument_json, self._attachments, first=self.frames
        )
        self._segments = number + 1
        return segment

    def _finish_segment(self, *, last: bool) -> None:
        """Hand the segment to the background thread, after the one before is done."""
        self._wait_for_disk()
        segment = self._segment
        if segment is None:
            return
        try:
            finish = partial(segment.finish, last=last, report=self.report.as_dict())
            self._finishing = self._disk.submit(finish)
            self._segment = None
        except MemoryError as error:
            self._fail(error)

    def _wait_for_disk(self) -> None:
        finishing, settling = self._finishing, self._settling
        self._finishing = self._settling = None
        working = [work for work in (finishing, settling) if work is not None]
        for work in working:  # a segment that is still used must not be closed
            work.wait()
        for work in working:
            try:
                work.result()
            except FAILURES as error:
                self._fail(error, part=work is finishing)

    def _fail(self, error: OSError | MemoryError, *, part: bool = False) -> None:
        """Close the segment as well as possible, and note the failure.

        `part` tells that an earlier segment could not be finished.
        """
        segment, self._segment = self._segment, None
        settling, self._settling = self._settling, None
        try:
            if settling is not None:  # it uses the file; what it says of the disk is known by now
                with suppress(*FAILURES):
                    settling.result()
            if segment is not None:
                segment.finish(last=True, report=self.report.as_dict())
        except FAILURES:
            part = True
        kept = f"{self.frames} frames before it are kept"
        if part:
            kept += f", the last of them in a {PART} file: save them with recover"
        self.error = RecordingError(f"writing {self.path} failed: {reason_of(error)}; {kept}")
        self._told = False

    def _refuse_leftovers(self, overwrite: bool) -> None:
        """Remove files of an earlier recording of this name, or refuse to."""
        finished, unfinished = segment_files(self.path)
        if unfinished and not overwrite:
            raise RecordingError(
                f"{unfinished[0]} is left from a recording that did not end: recover it, or "
                "choose another name"
            )
        if finished and not overwrite:
            raise RecordingError(describe_existing(finished[0]))
        for path in (*finished, *unfinished):
            path.unlink()


def reason_of(error: OSError | MemoryError, /) -> str:
    """Return in a few words why the system failed."""
    if isinstance(error, MemoryError):
        return "memory is exhausted"
    return error.strerror or str(error)
