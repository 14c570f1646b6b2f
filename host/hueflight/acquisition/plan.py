"""What a run of the camera is for, and what came of it."""

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
    """A capture that can't be taken as asked."""


@dataclass(frozen=True)
class RunPlan:
    """One run: what to look at, when to stop, where to put it.

    Attributes
    ----------
    kind : what the LEDs do.
    frames : stop after so many; of kind ``"bands"``, for each LED. 0 for no limit.
    seconds : stop after so long.
    photons_per_pixel : stop when the mean pixel has seen so many; of kind ``"bands"`` no rule.
    until : stop when a share of the pixels is known this well; of kind ``"scene"`` only.
    path : recording to write.
    metadata, attachments : go into the recording.
    keep : sum the whole run's histogram, one per LED of kind ``"bands"``.
    live : the default run, which makes way for any other.
    """

    kind: CaptureKind = "scene"
    frames: int = 0
    seconds: float | None = None
    photons_per_pixel: float | None = None
    until: PrecisionStop | None = None
    path: Path | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    keep: bool = False
    live: bool = False

    def check(self) -> None:
        """Refuse what can't be.

        Raises
        ------
        CaptureError
            If a limit is negative, an LED-by-LED run has no number of frames, or depth is to be
            known of what is no scene.
        """
        if not 0 <= self.frames <= FrameLimit.VALUE_MAX:
            raise CaptureError(f"frames = {self.frames}: must be from 0 to {FrameLimit.VALUE_MAX}")
        for name in ("seconds", "photons_per_pixel"):
            limit = getattr(self, name)
            if limit is not None and not 0 < limit < float("inf"):
                raise CaptureError(f"{name} = {limit}: must be a finite number above 0")
        if self.kind == "bands" and not self.frames:
            raise CaptureError("a capture of kind 'bands' needs frames: how many for each LED")

        if self.until is not None and self.kind != "scene":
            raise CaptureError(
                f"a capture of kind {self.kind!r} can't end by what is known of depth or "
                "reflectance: only 'scene' can; give frames, seconds or photons"
            )

    def frame_limit(self, instrument: Instrument) -> int:
        """Frames after which the camera itself ends the run, 0 for none."""
        return self.frames * (len(instrument.bands) if self.kind == "bands" else 1)


@dataclass(frozen=True)
class Gap:
    """A time in which nothing came, and why.

    Attributes
    ----------
    started, ended : UTC, ISO 8601; `ended` is empty while it lasts.
    seconds : how long, by a clock that does not jump.
    reason : what happened.
    frames_lost : exactly, where the camera could still say; else None.
    """

    started: str
    ended: str
    seconds: float
    reason: str
    frames_lost: int | None


@dataclass(frozen=True)
class RunResult:
    """What came of a run.

    Attributes
    ----------
    plan : as asked.
    totals : frames exposed, delivered and lost, by place.
    photons : detected.
    histograms : by step, where the plan said `keep`.
    simulated : whether the photons were.
    recorded_frames, recorded_bytes : safe in the recording.
    gaps : times in which the camera was away.
    share_known : of the pixels, as well as the plan's `until` wants, at the last look; else None.
    failure : why the run ended before its time, or the recording broke off; empty if neither.
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
