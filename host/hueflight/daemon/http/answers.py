# SPDX-License-Identifier: Apache-2.0
"""What answers of the API hold: types for the OpenAPI description.

Answers are made by the parts of the daemon as plain dictionaries; tests hold that they have the
fields that stand here, and no others. Clients should pass over fields that they do not know.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from hueflight.daemon.http.bodies import Kind

Count = Annotated[int, msgspec.Meta(ge=0)]
Seconds = Annotated[float, msgspec.Meta(description="Seconds.")]
State = Literal["disconnected", "idle", "running", "failed"]


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all answers."""


class StateAnswer(Answer, frozen=True, kw_only=True):
    """State of the camera before the request took effect."""

    state: State


class NameAnswer(Answer, frozen=True, kw_only=True):
    """Name of a recording."""

    name: str


class StepAnswer(Answer, frozen=True, kw_only=True):
    """Step of a calibration, or of its check."""

    step: str


class PictureAnswer(Answer, frozen=True, kw_only=True):
    """How live pictures are made from now on."""

    frames: Count
    number: Count
    integration_s: float | None
    method: str


class Losses(Answer, frozen=True, kw_only=True):
    """Frames lost, by place."""

    sensor: Count
    fpga: Count
    usb: Count
    host: Count
    disk: Count


class Part(Answer, frozen=True, kw_only=True):
    """Whether a part of the daemon works."""

    state: Literal["working", "failed", "stuck"]
    problem: str
    failures: Count


class Run(Answer, frozen=True, kw_only=True):
    """Progress of the present run; a limit of 0 means none."""

    frames: Count
    limit: Count
    photons: Count


class Totals(Answer, frozen=True, kw_only=True):
    """Totals since the daemon started."""

    exposed: Count
    delivered: Count
    photons: Count
    bytes: Count


class Link(Answer, frozen=True, kw_only=True):
    """The camera's link."""

    queue_bytes: Count
    stalls: Count
    stalled_s: float
    errors: Count
    connections: Count


class GapEntry(Answer, frozen=True, kw_only=True):
    """A time without the camera."""

    started: str
    seconds: float
    reason: str
    frames_lost: Count | None


class SimulationAnswer(Answer, frozen=True, kw_only=True):
    """State of a simulated camera; without fields if the camera is none."""

    plugged: bool | msgspec.UnsetType = msgspec.UNSET
    distinct_frames: Count | msgspec.UnsetType | None = msgspec.UNSET
    repeated: Count | msgspec.UnsetType = msgspec.UNSET
    moving: bool | msgspec.UnsetType = msgspec.UNSET
    drift_ps_per_s: float | msgspec.UnsetType = msgspec.UNSET
    delay_ps: float | msgspec.UnsetType = msgspec.UNSET
    calibrating: bool | msgspec.UnsetType = msgspec.UNSET


class Spread(Answer, frozen=True, kw_only=True):
    """Frames behind the pixels of a picture."""

    least: Count
    median: Count
    most: Count


class PictureStatus(Answer, frozen=True, kw_only=True):
    """The latest picture, and how pictures are made; no integration limit is null."""

    number: Count
    age_s: float | None
    stale: bool
    stale_after_s: Seconds
    skipped: Count
    method: str
    methods: list[str]
    integration_s: float | None
    frames: Spread


class Progress(Answer, frozen=True, kw_only=True):
    """How far the captures of a calibration have come."""

    frames: Count
    of_frames: Count
    seconds_left: float | None


class CalibrationStatus(Answer, frozen=True, kw_only=True):
    """Progress of a calibration, and whether pictures are calibrated."""

    step: str
    message: str
    path: str
    calibrated: bool
    progress: Progress | None


class CheckStatus(Answer, frozen=True, kw_only=True):
    """Progress of a check of the calibration, and what it found."""

    step: str
    message: str
    kind: str
    findings: list[str]
    correction: bool


class Summary(Answer, frozen=True, kw_only=True):
    """Summary of a recording that has ended; one that never began has a name and a failure."""

    name: str | msgspec.UnsetType = msgspec.UNSET
    kind: str | msgspec.UnsetType = msgspec.UNSET
    simulated: bool | msgspec.UnsetType = msgspec.UNSET
    started: str | msgspec.UnsetType = msgspec.UNSET
    seconds: float | msgspec.UnsetType = msgspec.UNSET
    note: str | msgspec.UnsetType = msgspec.UNSET
    calibration: str | msgspec.UnsetType = msgspec.UNSET
    exposed: Count | msgspec.UnsetType = msgspec.UNSET
    delivered: Count | msgspec.UnsetType = msgspec.UNSET
    photons: Count | msgspec.UnsetType = msgspec.UNSET
    recorded_frames: Count | msgspec.UnsetType = msgspec.UNSET
    recorded_bytes: Count | msgspec.UnsetType = msgspec.UNSET
    lost: Losses | msgspec.UnsetType = msgspec.UNSET
    gaps: list[GapEntry] | msgspec.UnsetType = msgspec.UNSET
    share_known: float | msgspec.UnsetType = msgspec.UNSET
    failure: str | msgspec.UnsetType = msgspec.UNSET


class RecordingStatus(Answer, frozen=True, kw_only=True):
    """The recording in progress, and the summary of the last one."""

    name: str
    frames: Count
    bytes: Count
    queue_bytes: Count
    failure: str
    paused: bool
    last: Summary


class StreamStatus(Answer, frozen=True, kw_only=True):
    """What the camera sends, why, and over which link; the link is empty if it is not known."""

    sent: Literal["codes", "sums"]
    configured: Literal["codes", "sums", "auto"]
    reason: str
    link: str


class Status(Answer, frozen=True, kw_only=True):
    """The daemon's status."""

    name: str
    instrument: str
    fingerprint: str
    state: State
    problem: str
    parts: dict[str, Part]
    simulated: bool
    camera: dict[str, str]
    kind: str
    run: Run
    totals: Totals
    lost: Losses
    link: Link
    gaps: list[GapEntry]
    simulation: SimulationAnswer | None
    rates: dict[str, float]
    picture: PictureStatus
    calibration: CalibrationStatus
    check: CheckStatus
    stream: StreamStatus
    recording: RecordingStatus
    latency_s: dict[str, float] | None
    viewers: Count
    uptime_s: Seconds


class BandFacts(Answer, frozen=True, kw_only=True):
    """A band; a width that is not stated is null."""

    name: str
    wavelength_nm: float
    fwhm_nm: float | None


class InstrumentFacts(Answer, frozen=True, kw_only=True):
    """What viewers need to know of an instrument."""

    name: str
    description: str
    rows: Count
    cols: Count
    codes: Count
    frame_rate_hz: float | None
    period_ns: float
    pixel_aspect: float
    slope_right: float
    slope_down: float
    fingerprint: str
    bands: list[BandFacts]
    flags: dict[str, int]
    guidance: dict[Kind, str]


class InstrumentAnswer(InstrumentFacts, frozen=True, kw_only=True):
    """The daemon's instrument, whose definition is JSON, and names of materials and indices."""

    protocol: str
    definition: str
    materials: dict[str, str]


class CameraFacts(Answer, frozen=True, kw_only=True):
    """One of several cameras; the address of the daemon's own is empty."""

    address: str
    instrument: InstrumentAnswer | None
    error: str


class CamerasAnswer(Answer, frozen=True, kw_only=True):
    """All cameras, the daemon's own first."""

    cameras: list[CameraFacts]


class CameraAnswer(Answer, frozen=True, kw_only=True):
    """State of one of several cameras, or name of its recording, or why it refused."""

    address: str
    state: State | None
    name: str | None
    error: str


class TogetherAnswer(Answer, frozen=True, kw_only=True):
    """Answers of all daemons, and the seconds within which they came."""

    cameras: list[CameraAnswer]
    within_s: Seconds


class RecordingFacts(Answer, frozen=True, kw_only=True):
    """A recording; what its summary does not say is null."""

    name: str
    bytes: Count
    segments: Count
    modified: str
    finished: bool
    kind: str | None
    simulated: bool | None
    started: str | None
    seconds: float | None
    frames: Count | None
    photons: Count | None
    lost: Losses | None
    gaps: Count | None
    note: str
    calibration: str
    failure: str


class RecordingsAnswer(Answer, frozen=True, kw_only=True):
    """The finished recordings, newest first."""

    recordings: list[RecordingFacts]


class ResultFacts(Answer, frozen=True, kw_only=True):
    """An image or counts in the folder of results."""

    name: str
    kind: Literal["image", "counts"]
    modified: str


class ResultsAnswer(Answer, frozen=True, kw_only=True):
    """The results, newest first."""

    results: list[ResultFacts]


class PlaybackAnswer(Answer, frozen=True, kw_only=True):
    """A recording or result that can be played."""

    name: str
    kind: str
    capture: str
    length: Count
    unit: str
    seconds: float | None
    simulated: bool | None
    calibration: str
    instrument: InstrumentFacts


class ScheduleAnswer(Answer, frozen=True, kw_only=True):
    """When each LED fires: delays of each band within the period, in nanoseconds."""

    delays_ns: list[list[float]]
    period_ns: float


class ScheduleLimits(Answer, frozen=True, kw_only=True):
    """Time step of the illuminator, its shortest and longest period, and pulses of each LED."""

    tick_ns: float
    period_ns: list[float]
    pulses: Count


class Limits(Answer, frozen=True, kw_only=True):
    """Least and greatest values of the controls; null where no board that has them was there."""

    rate_hz: list[float | None]
    rows: list[int]
    cols: list[int]
    gate: list[int]
    schedule: ScheduleLimits | None


class ControlsAnswer(Answer, frozen=True, kw_only=True):
    """What of camera and LEDs may be changed; null stands for the whole, or as stated."""

    rate_hz: float | None
    rows: list[int] | None
    cols: list[int] | None
    gate: list[int] | None
    masked: list[list[int]]
    leaves_out: bool
    actual_rate_hz: float | None
    schedule: ScheduleAnswer | None
    default_schedule: ScheduleAnswer | None
    limits: Limits


class BandValue(Answer, frozen=True, kw_only=True):
    """Reflectance of a pixel in one band."""

    reflectance: float | None
    reflectance_std: float | None


class Window(Answer, frozen=True, kw_only=True):
    """Time in which photons of one band arrive."""

    band: int
    start_ns: float
    stop_ns: float


class MaterialValue(Answer, frozen=True, kw_only=True):
    """Abundance of a material or spectral index of a pixel, with its standard deviation."""

    name: str
    value: float | None
    std: float | None


class PixelAnswer(Answer, frozen=True, kw_only=True):
    """One pixel; unknown numbers are null."""

    row: Count
    col: Count
    picture: Count
    frames: Count
    photons: Count
    edges_ns: list[float]
    counts: list[int]
    counts_missing: str
    depth_m: float | None
    depth_std_m: float | None
    background: float | None
    quality: list[str]
    bands: list[BandValue]
    windows: list[Window]
    materials: list[MaterialValue]


class HealthAnswer(Answer, frozen=True, kw_only=True):
    """Whether the daemon works."""

    healthy: bool
    state: State
    problems: list[str]
