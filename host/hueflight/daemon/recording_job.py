# SPDX-License-Identifier: Apache-2.0
"""Recording on command: one recording at a time, each a run of its own."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError, RunPlan, RunResult
from hueflight.acquisition.precision_stop import PrecisionStop
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.summary import WRITTEN_LATE, write_summary
from hueflight.calibration import Calibration
from hueflight.daemon.recordings_folder import RecordingsFolder, timestamp_name
from hueflight.devices.illumination import CaptureKind
from hueflight.reconstruction.stopping import StopRule

log = structlog.get_logger("hueflight.daemon")


class RecordingJob:
    """Begins and ends recordings, and writes the summary of each.

    Parameters
    ----------
    acquisition : Acquisition
        Acquisition that records.
    folder : RecordingsFolder
        Folder of the recordings.
    daemon_name : str
        Name of the daemon, which is noted in each recording.
    calibration : callable
        Returns the calibration in use, or None.
    calibration_name : callable
        Returns the name of the calibration in use, which is noted in each recording; empty if there
        is none.
    controls : callable
        Returns the controls of the camera, which are noted in each recording.
    on_ended : callable
        Called with name and summary of each recording that has ended.
    check_free : callable
        Raises a `CaptureError` if the camera is needed for something else.

    Attributes
    ----------
    last : dict
        Summary of the last recording; empty until one has ended.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        folder: RecordingsFolder,
        /,
        *,
        daemon_name: str,
        calibration: Callable[[], Calibration | None],
        calibration_name: Callable[[], str] = lambda: "",
        controls: Callable[[], dict[str, Any]] = dict,
        on_ended: Callable[[str, dict[str, Any]], None] = lambda _, __: None,
        check_free: Callable[[], None] = lambda: None,
    ) -> None:
        self._acquisition = acquisition
        self._folder = folder
        self._daemon_name = daemon_name
        self._calibration, self._calibration_name = calibration, calibration_name
        self._controls = controls
        self._on_ended = on_ended
        self._check_free = check_free
        self._lock = threading.Lock()
        self._name = ""
        self._future: Future[RunResult] | None = None
        self.last: dict[str, Any] = {}

    @property
    def name(self) -> str:
        """Name of the recording in progress; empty if there is none."""
        return self._name

    def begin(
        self,
        *,
        name: str = "",
        kind: CaptureKind = "scene",
        frames: int = 0,
        seconds: float | None = None,
        note: str = "",
        until: StopRule | None = None,
    ) -> str:
        """Begin a recording.

        Parameters
        ----------
        name : str
            Name of the recording; by default the present time.
        kind : str
            Kind of capture.
        frames : int
            Number of frames after which the recording ends; 0 for no limit.
        seconds : float, optional
            Time after which the recording ends.
        note : str
            Note that is kept in the recording.
        until : StopRule, optional
            Uncertainty at which the recording ends.

        Returns
        -------
        str
            Name of the recording.

        Raises
        ------
        RecordingNameError
            If the name is not allowed or taken.
        CaptureError
            If a recording is in progress, the limits are invalid, or `until` is given and there is
            no calibration to compute uncertainties with.
        """
        with self._lock:
            self.check_idle()
            self._check_free()
            calibration = self._calibration()
            if until is not None and calibration is None:
                raise CaptureError(
                    "uncertainties can't be computed, because there is no calibration: calibrate "
                    "first, or limit the recording by frames or seconds"
                )
            name = name or timestamp_name()
            path = self._folder.new_path(name)
            stated = {
                "note": note,
                "calibration": self._calibration_name(),
                "controls": json.dumps(self._controls()),
            }
            metadata = {"daemon": self._daemon_name} | {k: v for k, v in stated.items() if v}
            stop = (
                None if until is None or calibration is None else PrecisionStop(until, calibration)
            )
            plan = RunPlan(
                kind=kind,
                frames=frames,
                seconds=seconds,
                path=path,
                precision_stop=stop,
                metadata=metadata,
            )
            plan.check()
            self._name = name
        future = self._future = self._acquisition.run(plan)
        future.add_done_callback(lambda done: self._ended(name, done))
        return name

    def check_idle(self) -> None:
        """Refuse to disturb a recording.

        Raises
        ------
        CaptureError
            If a recording is in progress.
        """
        if self._name:
            raise CaptureError(f"recording {self._name!r} is in progress: end it first")

    @contextmanager
    def keep_off(self, *names: str) -> Iterator[None]:
        """Let no recording begin while files of recordings are changed.

        Parameters
        ----------
        *names : str
            Names of the recordings whose files are changed.

        Raises
        ------
        CaptureError
            If one of them is in progress.
        """
        with self._lock:
            if self._name in names:
                self.check_idle()
            yield

    def end(self) -> str:
        """End the recording in progress.

        Returns
        -------
        str
            Name of the recording.

        Raises
        ------
        CaptureError
            If no recording is in progress.
        """
        with self._lock:
            name = self._name
        if not name:
            raise CaptureError("no recording is in progress")
        future = self._future
        if future is None or not future.cancel():  # a run that has not begun can be cancelled
            self._acquisition.stop()
        return name

    def _ended(self, name: str, done: Future[RunResult]) -> None:
        """Called when a recording has ended, for whatever reason."""
        event = "recording failed"
        error = None if done.cancelled() else done.exception()
        if error is not None or done.cancelled():
            self.last = {"name": name, "failure": str(error or "ended before it began")}
        else:
            try:
                self.last = write_summary(self._folder.path(name), done.result())
                event = "recording ended"  # even if early: the summary says why
            except Exception as error:
                failure = done.result().failure or f"{WRITTEN_LATE}: {error}"
                self.last = {"name": name, "failure": failure}
        # before the name is free, so that nobody renames what is being finished
        self._on_ended(name, self.last)
        with self._lock:
            self._name = ""
        (log.error if self.last["failure"] else log.info)(event, **self.last)
