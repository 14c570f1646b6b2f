# SPDX-License-Identifier: Apache-2.0
"""Recording in a thread of its own: a slow disk can never delay acquisition.

Pieces of the stream wait in a bounded queue. When it is full, pieces are left out of the
recording, and the frames in them counted as lost to the disk; acquisition sees them all the same.
An error of the disk, a lack of room and any other failure concern the recording alone.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hueflight.acquisition.delay_histogram import DelayHistogram
from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.errors import RecordingError
from hueflight.files.room import Room
from hueflight.model.instrument import Instrument
from hueflight.recording import RecordingWriter
from hueflight.recording.writer import CHUNK_BYTES

QUEUE_BYTES = 128 << 20
#: written in one go at most: each call waits for the interpreter's lock again
BATCH_BYTES = 4 << 20
GATHER_S = 0.02  #: from the first piece of a batch until fewer bytes than that are written, too
MIN_FREE_BYTES = 256 << 20  #: recording stops before it takes the system's last bytes
INDEX_BYTES = 1 << 20  #: kept for the index that finishes a segment
RESUME_BYTES = 16 << 20  #: room beyond the reserve with which a paused recording goes on
ROOM_S = 0.1  #: from one look at the disk's room to the next, where there is plenty
RETRY_S = 5.0  #: after a failure, how often to look whether there is room again
FLUSH_S = 0.5


class Recorder:
    """Writes one recording in a thread of its own.

    Parameters
    ----------
    plan : RunPlan
        Says where to record, and which metadata and attachments to store.
    instrument : Instrument
        Instrument that takes the frames.
    queue_bytes : int
        Most bytes that wait for the disk.
    min_free_bytes : int
        Space that must stay free on the disk, in bytes. At this threshold the recording pauses,
        between two packets; it goes on in a new segment when there is room.
    on_event : callable, optional
        Receives the name and the details of what happens, in the thread of the recorder.
    write_delays : DelayHistogram, optional
        Counts the times from a piece's arrival until it is written.
    reduced : bool
        True if the camera sends sums instead of codes: frames are those behind whole pictures.

    Attributes
    ----------
    path : Path
        Where the recording is written.
    failure : str
        Why frames are missing from the recording, empty if none are.
    paused : bool
        True while frames are not written.

    Raises
    ------
    RecordingError
        If the recording can't be started.
    """

    def __init__(
        self,
        plan: RunPlan,
        instrument: Instrument,
        /,
        *,
        queue_bytes: int = QUEUE_BYTES,
        min_free_bytes: int = MIN_FREE_BYTES,
        on_event: Callable[[str, dict[str, Any]], None] | None = None,
        write_delays: DelayHistogram | None = None,
        reduced: bool = False,
    ) -> None:
        if plan.path is None:
            raise CaptureError("a recorder needs a plan with a path")
        self.path: Path = plan.path
        self.failure = ""
        self.paused = False
        self._reduced = reduced
        self._min_free = min_free_bytes
        self._on_event = on_event or (lambda _, __: None)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._disk = Room(self.path.parent)
            self._check_room(INDEX_BYTES)
            self._writer = RecordingWriter(
                plan.path, instrument, metadata=plan.metadata, attachments=plan.attachments
            )
        except OSError as error:
            raise RecordingError(
                f"can't start {self.path}: {error.strerror or error}: choose another folder or "
                "mend the disk"
            ) from error
        self._queue: deque[tuple[bytes, float]] = deque()  # pieces, and when they came
        self._write_delays = write_delays or DelayHistogram()
        self._queue_limit = queue_bytes
        self._enough_bytes = min(BATCH_BYTES, queue_bytes // 4)  # for a batch
        self._queued = 0
        self._skipped_bytes = self._offered_bytes = 0
        self._changed = threading.Condition()
        self._closing = self._broken = False
        self._retry_at = 0.0
        self._room, self._room_known_until = 0, 0.0  # that may be taken without another look
        self.thread = SupervisedThread(
            self._run, name="recorder", on_failure=self._break_off, restart=False
        )
        self.thread.start()

    def offer(self, piece: bytes, /) -> None:
        """Take a piece of the stream, or leave it out if the disk is too far behind.

        Parameters
        ----------
        piece : bytes
            Piece of the stream.
        """
        with self._changed:
            self._offered_bytes += len(piece)
            if self._broken:
                self._skipped_bytes += len(piece)
                return
            if self._queued + len(piece) > self._queue_limit:
                self._skipped_bytes += len(piece)
                self.failure = self.failure or (
                    f"the disk under {self.path.parent} is too slow: {self._queue_limit >> 20} MiB "
                    "wait for it"
                )
                return
            if not self._queue:  # otherwise the recorder knows that there are some
                self._changed.notify()
            self._queue.append((piece, time.monotonic()))
            self._queued += len(piece)

    @property
    def frames(self) -> int:
        """Number of frames that are safe in a file."""
        return self._writer.picture_frames if self._reduced else self._writer.frames

    @property
    def size(self) -> int:
        """Number of bytes that are safe in a file."""
        return self._writer.size

    @property
    def queued_bytes(self) -> int:
        """Number of bytes that wait for the disk."""
        return self._queued

    def lost_frames(self, delivered: int) -> int:
        """Return how many frames were not written; an estimate until the recording is closed.

        Parameters
        ----------
        delivered : int
            Number of frames delivered in the run.

        Returns
        -------
        int
            Number of frames.
        """
        if self._closing and not self.thread.alive:
            return max(0, delivered - self.frames)
        if not self._offered_bytes:
            return 0
        share = self._skipped_bytes / self._offered_bytes
        lost = self._writer.lost_picture_frames if self._reduced else self._writer.lost_frames
        return lost + round(delivered * share)

    def close(self) -> None:
        """Write what waits, finish the files, and wait for the disk."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self.thread.join()

    # -- the recorder's thread ----------------------------------------------------------------

    def _run(self) -> None:
        set_thread_priority(ThreadPriority.RECORDING)
        while True:
            self.thread.beat()
            with self._changed:
                if not self._queue and not self._closing:
                    self._changed.wait(FLUSH_S)
                if 0 < self._queued < self._enough_bytes and not self._closing:
                    self._changed.wait(GATHER_S)
                if not self._queue and self._closing:
                    break
                batch, size = [], 0
                while self._queue and (not batch or size + len(self._queue[0][0]) <= BATCH_BYTES):
                    batch.append(self._queue.popleft())
                    size += len(batch[-1][0])
                self._queued -= size
            self._put([piece for piece, _ in batch], size)
            if not self.paused:
                now = time.monotonic()
                self._write_delays.add(*(now - came_s for _, came_s in batch))
        try:
            self._writer.close()
        except (RecordingError, OSError) as error:
            self._pause(str(error))

    def _put(self, pieces: list[bytes], size: int) -> None:
        """Write pieces, or have the writer count the frames in them as lost while it is paused."""
        try:
            if self._writer.error is None:
                self._suspend_without_room(size)
            elif time.monotonic() >= self._retry_at:
                self._resume(size)
        except (RecordingError, OSError) as error:
            self._pause(str(error))
        try:
            if size:
                self._writer.write(*pieces)
            else:
                self._writer.flush()
        except (RecordingError, OSError) as error:
            self._pause(str(error))

    def _suspend_without_room(self, size: int) -> None:
        now = time.monotonic()
        if now < self._room_known_until and size <= self._room:
            self._room -= size
            return
        try:
            left = self._check_room(size + CHUNK_BYTES + INDEX_BYTES)
            # half of it: others may write there meanwhile
            self._room, self._room_known_until = left // 2, now + ROOM_S
        except (RecordingError, OSError) as error:
            # first of all: nothing that comes from here on may be written
            self._writer.suspend(str(error))
            raise

    def _resume(self, size: int) -> None:
        self._retry_at = time.monotonic() + RETRY_S
        self._check_room(size + CHUNK_BYTES + INDEX_BYTES + RESUME_BYTES)
        self._writer.resume()
        self.paused = False
        self._on_event("recording goes on", {"path": str(self.path), "failure": self.failure})

    def _pause(self, reason: str) -> None:
        self._retry_at = max(self._retry_at, time.monotonic() + RETRY_S)
        self.failure = reason
        if not self.paused:
            self.paused = True
            self._on_event("recording paused", {"path": str(self.path), "reason": reason})

    def _break_off(self, reason: str, trace: str) -> None:
        """After a fault of the program: what is in the files stays, all else counts as lost."""
        with self._changed:
            self._broken = self.paused = True
            self.failure = f"writing {self.path} broke off: {reason}"
            self._skipped_bytes += self._queued
            self._queue.clear()
            self._queued = 0
        details = {"path": str(self.path), "reason": self.failure, "traceback": trace}
        self._on_event("recorder failed", details)
        self._writer.close()

    def _check_room(self, size: int) -> int:
        return self._disk.require(size, reserve=self._min_free)
