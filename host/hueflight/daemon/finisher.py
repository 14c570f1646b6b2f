# SPDX-License-Identifier: Apache-2.0
"""Finishes recordings that were cut off by a crash, a power cut or an error of the disk."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError
from hueflight.acquisition.summary import write_summary_file
from hueflight.acquisition.supervised_thread import SupervisedThread
from hueflight.acquisition.thread_priority import ThreadPriority, set_thread_priority
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.errors import HueflightError
from hueflight.recording import finish_recording, open_recording
from hueflight.recording.layout import segment_files

log = structlog.get_logger("hueflight.daemon")
PATIENCE_S = 1800.0  #: for one recording; finishing one copies its last segment
BEAT_S = 1.0  #: from one sign of life to the next while there is nothing to finish
RETRY_S = 5.0  #: after a failure, when the disk may be well again; doubled with each one
LONGEST_RETRY_S = 300.0
CUT_OFF = "the program ended during the recording; it was finished when the daemon started again"


class Finisher:
    """Finishes recordings one after another, in a thread of its own.

    What can't be finished, for example because the disk fails, is tried again, ever more rarely.

    Parameters
    ----------
    folder : RecordingsFolder
        Folder of the recordings.
    on_finished : callable
        Called with path and summary of each recording that has ended, once its files are whole.

    Attributes
    ----------
    busy : frozenset of str
        Names of the recordings that wait or are being finished; those that failed and will be tried
        again are not among them.
    """

    def __init__(
        self,
        folder: RecordingsFolder,
        /,
        *,
        on_finished: Callable[[Path, dict[str, Any]], None] = lambda _, __: None,
    ) -> None:
        self._folder, self._on_finished = folder, on_finished
        self._lock = threading.Lock()
        self._names: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.busy: frozenset[str] = frozenset()
        self._summaries: dict[str, dict[str, Any]] = {}
        self._failed: dict[str, tuple[float, float]] = {}  # pause, and when to try again
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

    def finish(self, name: str, /, summary: dict[str, Any] | None = None) -> None:
        """Have a recording finished soon, if it has unfinished files or lacks its summary.

        Parameters
        ----------
        name : str
            Name of a recording that nobody writes.
        summary : dict, optional
            Summary of its run, for JSON, in case that it could not be written.
        """
        with self._lock:
            self.busy |= {name}
            if summary is not None:
                self._summaries[name] = summary
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
        while True:
            self.thread.beat(PATIENCE_S)
            try:
                name = self._names.get(timeout=BEAT_S)
            except queue.Empty:
                self._try_again()
                continue
            if name is None:
                return
            try:
                self._try(name)
            finally:
                with self._lock:
                    self.busy -= {name}
            self.thread.recovered()

    def _try_again(self) -> None:
        for name, (_, when_s) in list(self._failed.items()):
            if time.monotonic() >= when_s:
                self._try(name)

    def _try(self, name: str) -> None:
        try:
            self._finish(name)
        except (HueflightError, OSError) as error:
            if name not in self._failed:
                log.error("a recording can't be finished", name=name, reason=str(error))
            pause_s, _ = self._failed.get(name, (RETRY_S / 2, 0.0))
            pause_s = min(2 * pause_s, LONGEST_RETRY_S)
            self._failed[name] = (pause_s, time.monotonic() + pause_s)
        else:
            self._failed.pop(name, None)
            with self._lock:
                self._summaries.pop(name, None)

    def _finish(self, name: str) -> None:
        path = self._folder.path(name)
        if not any(segment_files(path)):
            return  # it never began, or was deleted or renamed meanwhile
        segments = finish_recording(path)
        with self._lock:
            summary = self._summaries.get(name)
        if summary is not None and not summary.get("failure"):
            self._on_finished(path, summary)
        if path.with_suffix(".json").exists() or not (segments or summary):
            return  # it was whole before
        if summary is None:
            with open_recording(path) as recording:
                summary = {
                    "name": name, "recorded_frames": recording.frames,
                    "recorded_bytes": recording.info().size, "failure": CUT_OFF,
                }  # fmt: skip
        write_summary_file(path, summary)
        log.warning(
            "recording finished after a cut", name=name, segments=segments,
            frames=summary.get("recorded_frames"),
        )  # fmt: skip
