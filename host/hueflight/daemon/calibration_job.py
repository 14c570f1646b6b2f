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
from hueflight.acquisition.thread_priority import ThreadPriority
from hueflight.calibration import Calibration
from hueflight.daemon.recordings_folder import timestamp_name
from hueflight.devices.illumination import CaptureKind
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

log = structlog.get_logger("hueflight.daemon")
CALIBRATION_NAME = "calibration.zarr"
_COMMAND = "from hueflight.cli import main; main()"
_WORK_TIMEOUT_S = 1800


@dataclass(frozen=True)
class CalibrationState:
    """Progress of a calibration.

    Attributes
    ----------
    step : str
        ``"idle"``, a kind of capture, ``"working"``, ``"done"`` or ``"failed"``.
    message : str
        The same in words.
    path : str
        Path of the calibration in use; empty if there is none.
    """

    step: str = "idle"
    message: str = ""
    path: str = ""


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
    """

    def __init__(
        self, acquisition: Acquisition, folder: Path, /, use: Callable[[Calibration], None]
    ) -> None:
        self._acquisition = acquisition
        self._folder = folder
        self._use = use
        self._busy = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._closing = False
        self.state = CalibrationState()

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
        if not self._busy.acquire(blocking=False):
            raise CaptureError("a calibration is in progress: wait until it is done")
        kinds: list[CaptureKind] = ["reference"]
        if bands:
            kinds.append("bands")
        if dark:
            kinds.append("dark")
        self.state = replace(self.state, step="reference", message="starting")
        threading.Thread(
            target=self._work, args=(kinds, distance, frames), name="calibrating", daemon=True
        ).start()

    def close(self) -> None:
        """Abandon a calibration that is in progress."""
        self._closing = True
        process = self._process
        if process is not None:
            process.terminate()

    def _work(self, kinds: list[CaptureKind], distance: float, frames: int) -> None:
        try:
            path = self._make(kinds, distance, frames)
            self._use(Calibration.load(path))
            self.state = CalibrationState("done", f"calibrated at {distance} m", str(path))
        except HueflightError as error:
            self.state = replace(self.state, step="failed", message=str(error))
        except (OSError, subprocess.SubprocessError) as error:
            self.state = replace(
                self.state, step="failed", message=f"the evaluation could not run: {error}"
            )
        except BaseException as error:
            message = f"{type(error).__name__}: {error}"
            log.error("calibration failed", reason=message, exc_info=error)
            self.state = replace(self.state, step="failed", message=message)
        finally:
            self._busy.release()

    def _make(self, kinds: list[CaptureKind], distance: float, frames: int) -> Path:
        folder = self._folder / timestamp_name()
        captures: dict[str, Path] = {}
        for kind in kinds:
            self.state = replace(self.state, step=kind, message=f"taking capture {kind!r}")
            path = folder / f"{kind}.mcap"
            plan = RunPlan(
                kind=kind, frames=frames, path=path, metadata={"distance_m": str(distance)}
            )
            result = self._wait(self._acquisition.run(plan))
            if result.failure:
                raise CaptureError(f"capture {kind!r} was interrupted: {result.failure}")
            captures[kind] = path
        self.state = replace(self.state, step="working", message="computing the calibration")
        self._calibrate(captures, distance, folder / CALIBRATION_NAME)
        return folder / CALIBRATION_NAME

    def _wait(self, future: Future[RunResult]) -> RunResult:
        while not self._closing:
            try:
                return future.result(timeout=0.5)
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
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        os.setpriority(os.PRIO_PROCESS, self._process.pid, ThreadPriority.CALIBRATION.niceness)
        output, errors = self._process.communicate(timeout=_WORK_TIMEOUT_S)
        if self._process.returncode:
            raise CaptureError(
                errors.strip()
                or f"'hueflight calibrate' failed with exit code {self._process.returncode}"
            )
        json.loads(output)
