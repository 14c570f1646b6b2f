# SPDX-License-Identifier: Apache-2.0
"""The plan of a run, and its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.precision_stop import PrecisionStop
from hueflight.devices.illumination import CaptureKind
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight_protocol.typed_registers.camera import FrameLimit


class CaptureError(HueflightError):
    """A capture that can't be taken as asked for."""


@dataclass(frozen=True)
class RunPlan:
    """What a run is for, when it ends, and where it is recorded.

    Attributes
    ----------
    kind : CaptureKind
        What the capture is for, which says what the LEDs do.
    frames : int
        Number of frames after which the run ends, for each LED where `kind` is ``"bands"``; 0 for
        no limit.
    seconds : float or None
        Time after which the run ends, in seconds.
    photons_per_pixel : float or None
        Mean number of photons per pixel at which the run ends.
    precision_stop : PrecisionStop or None
        Precision at which the run ends; only where `kind` is ``"scene"``.
    path : Path or None
        Recording to write.
    metadata : Mapping of str to str
        Metadata of the recording.
    attachments : Mapping of str to bytes
        Attachments of the recording.
    keep : bool
        True to sum the histogram of the whole run, one for each LED where `kind` is ``"bands"``.
    live : bool
        True for the run that is on by default and makes way for any other.
    """

    kind: CaptureKind = "scene"
    frames: int = 0
    seconds: float | None = None
    photons_per_pixel: float | None = None
    precision_stop: PrecisionStop | None = None
    path: Path | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    keep: bool = False
    live: bool = False

    def check(self) -> None:
        """Refuse a plan that contradicts itself.

        Raises
        ------
        CaptureError
            If a limit is out of range, a run of kind ``"bands"`` has no number of frames, or a
            precision is asked for of a run that is not of kind ``"scene"``.
        """
        if not 0 <= self.frames <= FrameLimit.VALUE_MAX:
            raise CaptureError(f"frames = {self.frames}: must be from 0 to {FrameLimit.VALUE_MAX}")
        for name in ("seconds", "photons_per_pixel"):
            limit = getattr(self, name)
            if limit is not None and not 0 < limit < float("inf"):
                raise CaptureError(f"{name} = {limit}: must be a finite number above 0")
        if self.kind == "bands" and not self.frames:
            raise CaptureError("a capture of kind 'bands' needs frames: how many for each LED")

        if self.precision_stop is not None and self.kind != "scene":
            raise CaptureError(
                f"a capture of kind {self.kind!r} can't end by what is known of depth or "
                "reflectance: only 'scene' can; give frames, seconds or photons"
            )

    @property
    def needs_histograms(self) -> bool:
        """True if the run is of no use without the codes of all frames."""
        return self.kind != "scene" or self.keep or self.precision_stop is not None

    def frame_limit(self, instrument: Instrument) -> int:
        """Return the number of frames after which the camera itself ends the run.

        Parameters
        ----------
        instrument : Instrument
            Instrument whose LEDs fire.

        Returns
        -------
        int
            Number of frames, 0 for no limit.
        """
        return self.frames * (len(instrument.bands) if self.kind == "bands" else 1)


@dataclass(frozen=True)
class Gap:
    """A time in which no data came, and why.

    Attributes
    ----------
    started, ended : str
        UTC in ISO 8601.
    seconds : float
        Duration by a clock that does not jump, in seconds.
    reason : str
        What happened.
    frames_lost : int or None
        Number of frames lost, None where the camera could not tell.
    """

    started: str
    ended: str
    seconds: float
    reason: str
    frames_lost: int | None


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes
    ----------
    plan : RunPlan
        The plan of the run.
    totals : RunTotals
        Frames exposed, delivered and lost.
    photons : int
        Number of photons detected.
    histograms : dict of int to ndarray, shape (row, col, code)
        Histogram by sequencer step, where the plan asks to keep it.
    simulated : bool
        True if the photons are simulated.
    recorded_frames, recorded_bytes : int
        What is safe in the recording.
    gaps : tuple of Gap
        Times in which the camera was away.
    share_known : float or None
        Fraction of pixels that had the precision of the plan at the last reconstruction; None for
        a plan without a precision.
    failure : str
        Why the run ended before its time or the recording broke off; empty if neither.
    started : str
        UTC in ISO 8601 when the run began.
    seconds : float
        Time from the run's beginning to its result, by a clock that does not jump, in seconds.
    """

    plan: RunPlan
    totals: RunTotals
    photons: int
    histograms: dict[int, NDArray[np.unsignedinteger]]
    simulated: bool
    recorded_frames: int = 0
    recorded_bytes: int = 0
    gaps: tuple[Gap, ...] = ()
    share_known: float | None = None
    failure: str = ""
    started: str = ""
    seconds: float = float("nan")
