# SPDX-License-Identifier: Apache-2.0
"""Check on command whether the calibration in use still holds.

Frames are taken of the reference target, or of the scene as it is. Of the target, delay, brightness
and width of every band and all pixels are compared with the calibration. Of the scene, residuals of
all pixels together tell what departs from it. Drift of the LEDs is then offered as a correction.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import structlog
from numpy.typing import NDArray

from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.runner import Acquisition
from hueflight.calibration import Calibration, check_calibration
from hueflight.calibration.drift import with_drift
from hueflight.calibration.suspects import drift_of
from hueflight.daemon.calibration_job import CALIBRATION_NAME
from hueflight.daemon.recordings_folder import timestamp_name
from hueflight.errors import HueflightError
from hueflight.reconstruction.departures import correct_drift
from hueflight.reconstruction.entry_point import reconstruct

log = structlog.get_logger("hueflight.daemon")
CheckKind = Literal["reference", "scene"]


@dataclass(frozen=True)
class CheckState:
    """Progress of a check, and what it found.

    Attributes
    ----------
    step : str
        ``"idle"``, ``"capture"``, ``"working"``, ``"done"``, ``"failed"`` or ``"corrected"``.
    message : str
        The same in words.
    kind : str
        Kind of the capture, ``"reference"`` or ``"scene"``.
    findings : tuple of str
        What has changed, in words.
    correction : Calibration or None
        Calibration with the drift that was found, as long as it is offered.
    """

    step: str = "idle"
    message: str = ""
    kind: str = ""
    findings: tuple[str, ...] = ()
    correction: Calibration | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the state as plain values, for the API.

        Returns
        -------
        dict
            The attributes; ``correction`` tells whether one is offered.
        """
        return {
            "step": self.step,
            "message": self.message,
            "kind": self.kind,
            "findings": list(self.findings),
            "correction": self.correction is not None,
        }


class CheckJob:
    """Takes a capture, compares it with the calibration in use, and corrects that on request.

    Parameters
    ----------
    acquisition : Acquisition
        Acquisition that takes the capture.
    folder : Path
        Folder in which calibrations are kept.
    calibration : callable
        Returns the calibration in use, or None.
    use : callable
        Called with a corrected calibration and the path where it is kept.
    check_free : callable
        Raises a `CaptureError` if the camera is needed for something else.

    Attributes
    ----------
    state : CheckState
        Progress and findings.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        folder: Path,
        /,
        *,
        calibration: Callable[[], Calibration | None],
        use: Callable[[Calibration, Path], None],
        check_free: Callable[[], None],
    ) -> None:
        self._acquisition, self._folder = acquisition, folder
        self._calibration, self._use, self._check_free = calibration, use, check_free
        self._busy = threading.Lock()
        self._ending = threading.Lock()
        self.state = CheckState()

    def begin(self, *, kind: CheckKind, frames: int, distance: float | None) -> None:
        """Begin a check; it goes on in a thread of its own.

        Parameters
        ----------
        kind : {"reference", "scene"}
            What the camera sees.
        frames : int
            Frames of the capture.
        distance : float or None
            Distance of the reference target, m; by default that of the calibration.

        Raises
        ------
        CaptureError
            If there is no calibration, or the camera is needed for something else.
        """
        calibration = self._calibration()
        if calibration is None:
            raise CaptureError("there is no calibration to check: calibrate first")
        with self._ending:
            free = self._busy.acquire(blocking=False)
        if not free:
            raise CaptureError("a check is in progress: wait until it is done")
        try:
            self._check_free()
        except CaptureError:
            self._busy.release()
            raise
        self.state = CheckState("capture", f"taking capture {kind!r}", kind)
        threading.Thread(
            target=self._work,
            args=(calibration, kind, frames, distance),
            name="checking",
            daemon=True,
        ).start()

    def check_idle(self) -> None:
        """Refuse to disturb a check.

        Raises
        ------
        CaptureError
            If a check is in progress.
        """
        if self._busy.locked():
            raise CaptureError("a check of the calibration is in progress: wait until it is done")

    def forget(self) -> None:
        """Forget the last check, because another calibration is in use."""
        self.state = CheckState()

    def correct(self) -> Path:
        """Keep and use the calibration with the drift that the last check found.

        Returns
        -------
        Path
            Where the corrected calibration is kept.

        Raises
        ------
        CaptureError
            If a check is in progress, or none has offered a correction.
        """
        self.check_idle()
        corrected = self.state.correction
        if corrected is None:
            raise CaptureError("no correction is offered: only a check that finds drift offers one")
        path = self._folder / timestamp_name() / CALIBRATION_NAME
        path.parent.mkdir(parents=True)
        corrected.save(path)
        self._use(corrected, path)
        self.state = CheckState("corrected", "drift of the LEDs corrected", self.state.kind)
        log.info("calibration corrected", path=str(path))
        return path

    def _work(
        self, calibration: Calibration, kind: CheckKind, frames: int, distance: float | None
    ) -> None:
        end = self._outcome(calibration, kind, frames, distance)
        with self._ending:  # whoever sees the end may begin the next
            self._busy.release()
            self.state = end

    def _outcome(
        self, calibration: Calibration, kind: CheckKind, frames: int, distance: float | None
    ) -> CheckState:
        """Take the capture and compare; how it ended."""
        try:
            result = self._acquisition.run(RunPlan(kind=kind, frames=frames, keep=True)).result()
            if result.failure:
                raise CaptureError(f"capture {kind!r} was interrupted: {result.failure}")
            self.state = CheckState("working", "comparing with the calibration", kind)
            (counts,) = result.histograms.values()
            if kind == "reference":
                found = of_reference(calibration, counts, result.totals.delivered, distance)
            else:
                found = of_scene(calibration, counts, result.totals.delivered)
            log.info("calibration checked", kind=kind, findings=list(found.findings))
            return found
        except HueflightError as error:
            log.warning("check of the calibration failed", reason=str(error))
            return CheckState("failed", str(error), kind)
        except BaseException as error:
            message = f"{type(error).__name__}: {error}"
            log.error("check of the calibration failed", reason=message, exc_info=error)
            return CheckState("failed", message, kind)


def of_reference(
    calibration: Calibration,
    counts: NDArray[np.unsignedinteger],
    frames: int,
    distance: float | None,
) -> CheckState:
    """Compare a capture of the reference target with a calibration.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    counts : ndarray, shape (row, col, code)
        Counts of the capture.
    frames : int
        Its exposures.
    distance : float or None
        Distance of the target, m; by default that of the calibration.

    Returns
    -------
    CheckState
        What has changed, with a correction where LEDs have drifted.
    """
    found = check_calibration(calibration, counts, distance=distance, frames=frames)
    delays_ps, factors = drift_of(found.suspects, len(found.bands))
    drifted = not found.holds and (delays_ps.any() or (factors != 1).any())
    return CheckState(
        "done", _verdict(found.holds), "reference", found.findings,
        with_drift(calibration, delay_ps=delays_ps, width_factor=factors) if drifted else None,
    )  # fmt: skip


def of_scene(
    calibration: Calibration, counts: NDArray[np.unsignedinteger], frames: int
) -> CheckState:
    """Find from a capture of any scene what departs from a calibration.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    counts : ndarray, shape (row, col, code)
        Counts of the capture.
    frames : int
        Its exposures.

    Returns
    -------
    CheckState
        What departs, with a correction where LEDs have drifted.
    """
    image = reconstruct(counts, calibration, frames=frames)
    found = correct_drift(counts, calibration, image, frames=frames)
    drifted = found.calibration is not calibration
    findings = tuple(str(suspect) for suspect in found.before.found)
    return CheckState(
        "done", _verdict(found.before.holds), "scene", findings,
        found.calibration if drifted else None,
    )  # fmt: skip


def _verdict(holds: bool) -> str:
    return "the calibration holds" if holds else "the calibration no longer holds"
