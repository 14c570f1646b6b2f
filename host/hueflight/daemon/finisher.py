# SPDX-License-Identifier: Apache-2.0
"""Finishes recordings that were cut off by a crash, a power cut or an error of the disk."""

from __future__ import annotations

import queue
import threading
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError
from hueflight.acquisition.summary import write_summary_file
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.errors import HueflightError
from hueflight.recording import finish_recording, open_recording

log = structlog.get_logger("hueflight.daemon")
CUT_OFF = "the program ended during the recording; it was finished when the daemon started again"


class Finisher:
    """Finishes recordings one after another, in a thread of its own.

    Parameters
    ----------
    folder : RecordingsFolder
        Folder of the recordings.

    Attributes
    ----------
    busy : frozenset of str
        Names of the recordings that wait or are being finished.
    """

    def __init__(self, folder: RecordingsFolder, /) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._names: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.busy: frozenset[str] = frozenset()
        self.thread = SupervisedThread(
            self._work,
            name="finisher",
            on_failure=lambda reason, trace: log.error(
                "finishing failed", reason=reason, traceback=trace
            ),
        )
        self.thread.start()
        for name in folder.unfinished():
            self.finish(name)

    def finish(self, name: str, /) -> None:
        """Have a recording finished soon, if it has unfinished files.

        Parameters
        ----------
        name : str
            Name of a recording that nobody writes.
        """
        with self._lock:
            self.busy |= {name}
        self._names.put(name)

    def check_idle(self, name: str, /) -> None:
        """Refuse to disturb a recording that waits or is being finished.

        Parameters
        ----------
        name : str
            Name of the recording.

        Raises
        ------
        CaptureError
            If it does.
        """
        if name in self.busy:
            raise CaptureError(f"recording {name!r} is being finished: try again soon")

    def close(self) -> None:
        """End the thread after the recording in hand."""
        self._names.put(None)
        self.thread.end()
        self.thread.join(30.0)

    def _work(self) -> None:
        set_thread_priority(ThreadPriority.CALIBRATION)
        while (name := self._names.get()) is not None:
            try:
                self._finish(name)
            finally:
                with self._lock:
                    self.busy -= {name}
            self.thread.recovered()

    def _finish(self, name: str) -> None:
        path = self._folder.path(name)
        try:
            segments = finish_recording(path)
            if not segments:
                return
            with open_recording(path) as recording:
                frames, size = recording.frames, recording.info().size
            if not path.with_suffix(".json").exists():
                summary: dict[str, Any] = {
                    "name": name, "recorded_frames": frames, "recorded_bytes": size,
                    "failure": CUT_OFF,
                }  # fmt: skip
                write_summary_file(path, summary)
        except (HueflightError, OSError) as error:
            log.error("a recording can't be finished", name=name, reason=str(error))
            return
        log.warning("recording finished after a cut", name=name, frames=frames, segments=segments)
