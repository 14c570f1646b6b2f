"""Recording in a thread of its own: a slow disk can never delay acquisition.

Pieces of the stream wait in a bounded queue. When it is full, pieces are left out of the
recording, and the frames in them counted as lost to the disk; acquisition sees them all the same.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections import deque
from pathlib import Path

from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.errors import RecordingError
from hueflight.model.instrument import Instrument
from hueflight.recording import RecordingWriter

QUEUE_BYTES = 128 << 20
BATCH_BYTES = (
    4 << 20
)  #: written in one go at most: each call waits for the interpreter's lock again
MIN_FREE_BYTES = 256 << 20  #: recording stops before it takes the system's last bytes
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
        Space that must stay free on the disk, in bytes.

    Attributes
    ----------
    path : Path
        Where the recording is written.
    failure : str
        Why writing broke off, empty if it did not.

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
    ) -> None:
        if plan.path is None:
            raise CaptureError("a recorder needs a plan with a path")
        self.path: Path = plan.path
        self.failure = ""
        self._min_free = min_free_bytes
        self._check_space()
        self._writer = RecordingWriter(
            plan.path, instrument, metadata=plan.metadata, attachments=plan.attachments
        )
        self._queue: deque[bytes] = deque()
        self._queue_limit = queue_bytes
        self._queued = 0
        self._skipped_bytes = self._offered_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._retry_at = 0.0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def offer(self, piece: bytes, /) -> None:
        """Take a piece of the stream, or leave it out if the disk is too far behind.

        Parameters
        ----------
        piece : bytes
            Piece of the stream.
        """
        with self._changed:
            self._offered_bytes += len(piece)
            if self._queued + len(piece) > self._queue_limit:
                self._skipped_bytes += len(piece)
                self.failure = self.failure or (
                    f"the disk under {self.path.parent} is too slow: {self._queue_limit >> 20} MiB "
                    "wait for it"
                )
                return
            self._queue.append(piece)
            self._queued += len(piece)
            self._changed.notify()

    @property
    def frames(self) -> int:
        """Number of frames that are safe in a file."""
        return self._writer.frames

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
        if self._closing and not self._thread.is_alive():
            return max(0, delivered - self._writer.frames)
        if not self._offered_bytes:
            return 0
        share = self._skipped_bytes / self._offered_bytes
        return self._writer.lost_frames + round(delivered * share)

    def close(self) -> None:
        """Write what waits, finish the files, and wait for the disk."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()

    # -- the recorder's thread ----------------------------------------------------------------

    def _run(self) -> None:
        set_thread_priority(ThreadPriority.RECORDING)
        while True:
            with self._changed:
                if not self._queue and not self._closing:
                    self._changed.wait(FLUSH_S)
                if not self._queue and self._closing:
                    break
                batch, size = [], 0
                while self._queue and (not batch or size + len(self._queue[0]) <= BATCH_BYTES):
                    batch.append(self._queue.popleft())
                    size += len(batch[-1])
                self._queued -= size
            self._put(b"".join(batch) if batch else None)
        try:
            self._writer.close()
        except RecordingError as error:
            self.failure = str(error)

    def _put(self, piece: bytes | None) -> None:
        try:
            if self._writer.error is None:
                self._check_space_now_and_then()
            elif time.monotonic() >= self._retry_at:
                self._retry_at = time.monotonic() + RETRY_S
                self._check_space()
                self._writer.resume()
            if piece is None:
                self._writer.flush()
            else:
                self._writer.write(piece)
        except RecordingError as error:
            self.failure = str(error)
            self._retry_at = max(self._retry_at, time.monotonic() + RETRY_S)

    _space_checked = 0.0

    def _check_space_now_and_then(self) -> None:
        if time.monotonic() - self._space_checked > 1.0:
            self._space_checked = time.monotonic()
            self._check_space()

    def _check_space(self) -> None:
        folder = self.path.parent
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
        if free < self._min_free:
            raise RecordingError(
                f"only {free >> 20} MiB are free under {folder}, recording needs more than "
                f"{self._min_free >> 20} MiB: make room or choose another folder"
            )
