# SPDX-License-Identifier: Apache-2.0
"""Calibration on command: captures are recorded, then evaluated in a separate process.

The raw captures are kept beside the calibration, so that it can be computed again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

import structlog

from hueflight.acquisition.plan import CaptureError, RunPlan, RunResult
from hueflight.acquisition.runner import Acquisition
from hueflight.acquisition.thread_priority import ThreadPriority, set_niceness
from hueflight.calibration import Calibration
from hueflight.daemon.recordings_folder import timestamp_name
from hueflight.devices.illumination import CaptureKind
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.numerical_threads import ONE_THREAD

log = structlog.get_logger("hueflight.daemon")
CALIBRATION_NAME = "calibration.zarr"
_COMMAND = "from hueflight.cli import main; main()"
_WORK_TIMEOUT_S = 1800
OTHER_SCHEDULE = "no calibration fits the schedule of the LEDs: calibrate with this schedule"
MOST_LOST = 0.01  #: share of the frames of a capture that may be lost


@dataclass(frozen=True)
class CalibrationState:
    """Progress of a calibration.

    Attributes
    ----------
    step : str
        ``"idle"``, a kind of capture, ``"working"``, ``"done"``, ``"failed"`` or ``"cancelled"``.
    message : str
        The same in words.
    path : str
        Path of the calibration in use; empty if there is none.
    """

    step: str = "idle"
    message: str = ""
    path: str = ""


@dataclass(frozen=True)
class CalibrationProgress:
    """How far the captures of a calibration have come.

    Attributes
    ----------
    frames : int
        Frames taken.
    of_frames : int
        Frames of all captures.
    seconds_left : float or None
        Time until the last capture ends; None while the calibration is computed.
    """

    frames: int
    of_frames: int
    seconds_left: float | None


class CancelledError(CaptureError):
    """A calibration that was cancelled."""


class CalibrationJob:
    """Takes the captures of a calibration one after another, and uses the result.

    Parameters
    ----------
    acquisition : Acquisition
        Acquisition that takes the captures.
    folder : Path
        Folder in which calibrations are kept.
    use : callable
        Called with each finished calibration.
    check_free : callable
        Raises a `CaptureError` if the camera is needed for something else.

    Attributes
    ----------
    state : CalibrationState
        Progress in words.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        folder: Path,
        /,
        use: Callable[[Calibration], None],
        *,
        check_free: Callable[[], None] = lambda: None,
    ) -> None:
        self._check_free = check_free
        self._cancelled = threading.Event()
        self._future: Future[RunResult] | None = None
        self._frames_before = self._frames_wanted = 0
        self._acquisition = acquisition
        self._folder = folder
        self._use = use
        self._busy = threading.Lock()
        self._ending = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._closing = False
        self.state = CalibrationState()

    @property
    def name(self) -> str:
        """Name of the calibration in use, which is that of its folder; empty if there is none."""
        return Path(self.state.path).parent.name if self.state.path else ""

    def follow(self, instrument: Instrument, /) -> None:
        """Use the newest calibration that fits a schedule that was changed, or none.

        Parameters
        ----------
        instrument : Instrument
            The instrument with its present schedule.
        """
        self.state = CalibrationState()
        self.load_latest(instrument)
        if not self.state.path:
            self.state = CalibrationState("idle", OTHER_SCHEDULE)

    def load_latest(self, instrument: Instrument) -> None:
        """Use the newest calibration of this instrument, if there is any.

        Parameters
        ----------
        instrument : Instrument
            Instrument that the calibration must belong to.
        """
        for path in sorted(self._folder.glob(f"*/{CALIBRATION_NAME}"), reverse=True):
            try:
                calibration = Calibration.load(path)
                calibration.require(instrument)
            except HueflightError as error:
                self.state = CalibrationState(
                    "idle", f"calibration {path.parent.name} can't be used: {error}"
                )
                continue
            self._use(calibration)
            self.state = CalibrationState(
                "done", f"calibrated at {calibration.distance} m", str(path)
            )
            return

    def use_simulated(self, calibration: Calibration, /) -> None:
        """Use the calibration that comes along with a simulated camera; it is not kept.

        Parameters
        ----------
        calibration : Calibration
            The calibration.
        """
        if self._busy.locked() or self.state.path:
            return
        self._use(calibration)
        message = f"calibrated by simulation at {calibration.distance} m"
        self.state = CalibrationState("done", message, "")

    def use_corrected(self, calibration: Calibration, path: Path, /) -> None:
        """Use a corrected calibration, which is kept already.

        Parameters
        ----------
        calibration : Calibration
            The calibration.
        path : Path
            Where it is kept.
        """
        self._use(calibration)
        self.state = CalibrationState(
            "done", "calibrated, with drift of the LEDs corrected", str(path)
        )

    def begin(self, *, distance: float, frames: int, bands: bool, dark: bool) -> None:
        """Begin a calibration; it goes on in a thread of its own.

        Parameters
        ----------
        distance : float
            Distance of the reference target, in metres.
        frames : int
            Frames of each capture.
        bands : bool
            Also capture the target with one LED at a time.
        dark : bool
            Also take a capture with all LEDs off.

        Raises
        ------
        CaptureError
            If a calibration is in progress.
        """
        with self._ending:
            free = self._busy.acquire(blocking=False)
        if not free:
            raise CaptureError("a calibration is in progress: wait until it is done, or cancel it")
        try:
            self._check_free()
            if self._acquisition.controls.leaves_out:
                raise CaptureError(
                    "the camera leaves out pixels or codes, of which nothing could be calibrated: "
                    "reset rows, cols, gate and masked first (POST /api/controls)"
                )
        except CaptureError:
            self._busy.release()
            raise
        kinds: list[CaptureKind] = ["reference"]
        if bands:
            kinds.append("bands")
        if dark:
            kinds.append("dark")
        self._cancelled.clear()
        self._frames_before = 0
        self._frames_wanted = sum(self._limit(kind, frames) for kind in kinds)
        self.state = replace(self.state, step="reference", message="starting")
        log.info("calibration started", distance=distance, frames=frames, captures=kinds)
        threading.Thread(
            target=self._work, args=(kinds, distance, frames), name="calibrating", daemon=True
        ).start()

    def check_idle(self) -> None:
        """Refuse to disturb a calibration.

        Raises
        ------
        CaptureError
            If a calibration is in progress.
        """
        if self._busy.locked():
            raise CaptureError("a calibration is in progress: wait until it is done, or cancel it")

    def progress(self) -> CalibrationProgress | None:
        """Return how far the captures have come.

        Returns
        -------
        CalibrationProgress or None
            None if no calibration is in progress.
        """
        if not self._busy.locked():
            return None
        snapshot = self._acquisition.snapshot
        future = self._future
        present = 0
        if future is not None and not future.done() and snapshot.kind == self.state.step:
            present = snapshot.run_frames
        frames = min(self._frames_before + present, self._frames_wanted)
        rate_hz = self._acquisition.settings.rate_hz
        seconds = (self._frames_wanted - frames) / rate_hz
        working = self.state.step == "working"
        return CalibrationProgress(frames, self._frames_wanted, None if working else seconds)

    def cancel(self) -> None:
        """Cancel the calibration in progress; the one in use stays in use.

        Raises
        ------
        CaptureError
            If no calibration is in progress.
        """
        if not self._busy.locked():
            raise CaptureError("no calibration is in progress")
        self._cancelled.set()
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()

    def _limit(self, kind: CaptureKind, frames: int) -> int:
        return RunPlan(kind=kind, frames=frames).frame_limit(self._acquisition.instrument)

    def close(self) -> None:
        """Abandon a calibration that is in progress."""
        self._closing = True
        process = self._process
        if process is not None:
            process.terminate()

    def _work(self, kinds: list[CaptureKind], distance: float, frames: int) -> None:
        end = self._outcome(kinds, distance, frames)
        with self._ending:  # whoever sees the end may begin the next
            self._busy.release()
            self.state = end

    def _outcome(self, kinds: list[CaptureKind], distance: float, frames: int) -> CalibrationState:
        """Make the calibration; how it ended."""
        try:
            path, lost = self._make(kinds, distance, frames)
            self._use(Calibration.load(path))
            message = f"calibrated at {distance} m"
            if lost:
                message += f"; {lost} of {self._frames_wanted} frames were lost"
            log.info("calibration done", path=str(path), frames_lost=lost)
            return CalibrationState("done", message, str(path))
        except CancelledError:
            kept = "the earlier one stays in use" if self.state.path else "there is none in use"
            log.info("calibration cancelled")
            return replace(self.state, step="cancelled", message=f"cancelled: {kept}")
        except HueflightError as error:
            log.error("calibration failed", reason=str(error))
            return replace(self.state, step="failed", message=str(error))
        except (OSError, subprocess.SubprocessError) as error:
            return replace(
                self.state, step="failed", message=f"the evaluation could not run: {error}"
            )
        except BaseException as error:
            message = f"{type(error).__name__}: {error}"
            log.error("calibration failed", reason=message, exc_info=error)
            return replace(self.state, step="failed", message=message)

    def _make(self, kinds: list[CaptureKind], distance: float, frames: int) -> tuple[Path, int]:
        """Take the captures and compute the calibration; its path, and the frames lost."""
        folder = self._folder / timestamp_name()
        captures: dict[str, Path] = {}
        lost = 0
        for kind in kinds:
            self._check_cancelled()
            self.state = replace(self.state, step=kind, message=f"taking capture {kind!r}")
            path = folder / f"{kind}.mcap"
            plan = RunPlan(
                kind=kind, frames=frames, path=path, metadata={"distance_m": str(distance)}
            )
            self._future = self._acquisition.run(plan)
            result = self._wait(self._future)
            self._check_cancelled()
            if result.failure:
                raise CaptureError(f"capture {kind!r} was interrupted: {result.failure}")
            lost += self._count_lost(kind, self._limit(kind, frames), result)
            self._frames_before += self._limit(kind, frames)
            log.info("capture of a calibration taken", kind=kind, frames=result.recorded_frames)
            captures[kind] = path
        self.state = replace(self.state, step="working", message="computing the calibration")
        self._calibrate(captures, distance, folder / CALIBRATION_NAME)
        return folder / CALIBRATION_NAME, lost

    @staticmethod
    def _count_lost(kind: CaptureKind, wanted: int, result: RunResult) -> int:
        """Frames that are missing from a capture, which must be few."""
        lost = wanted - result.recorded_frames
        if lost > MOST_LOST * wanted:
            raise CaptureError(
                f"capture {kind!r} has {result.recorded_frames} of {wanted} frames: it was ended "
                "early, or the link or the disk lost them; calibrate again"
            )
        return max(0, lost)

    def _check_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise CancelledError("the calibration was cancelled")

    def _wait(self, future: Future[RunResult]) -> RunResult:
        stopped = False
        while not self._closing:
            if self._cancelled.is_set() and not stopped:
                if future.cancel():
                    raise CancelledError("the calibration was cancelled")
                self._acquisition.stop()
                stopped = True
            try:
                return future.result(timeout=0.2)
            except TimeoutError:
                continue
        raise CaptureError("the daemon is shutting down")

    def _calibrate(self, captures: dict[str, Path], distance: float, out: Path) -> None:
        command = [sys.executable, "-c", _COMMAND, "calibrate", str(captures["reference"])]
        command += ["--distance", str(distance), "--out", str(out), "--json"]
        for kind in ("bands", "dark"):
            if kind in captures:
                command += [f"--{kind}", str(captures[kind])]
        # one thread, low priority: acquisition comes first
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | ONE_THREAD,
        )
        if self._cancelled.is_set():  # meanwhile
            self._process.terminate()
        set_niceness(self._process.pid, ThreadPriority.CALIBRATION)
        output, errors = self._process.communicate(timeout=_WORK_TIMEOUT_S)
        self._check_cancelled()
        if self._process.returncode:
            raise CaptureError(
                errors.strip()
                or f"'hueflight calibrate' failed with exit code {self._process.returncode}"
            )
        json.loads(output)
