# SPDX-License-Identifier: Apache-2.0
"""Operations of the API: one table, from which routes and OpenAPI description are generated."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec

from hueflight.daemon.picture_settings import LONGEST_S
from hueflight.daemon.pixel import inspect
from hueflight.daemon.service import Service
from hueflight.reconstruction.stopping import StopRule

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"
Name = Annotated[
    str,
    msgspec.Meta(
        pattern=NAME_PATTERN,
        description="Name of the recording. By default it is the present time.",
    ),
]
Kind = Annotated[
    Literal["scene", "reference", "bands", "dark", "flat"],
    msgspec.Meta(
        description="Kind of capture, which decides which LEDs fire: all for scene and reference, "
        "one at a time for bands, none for dark and flat."
    ),
]


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Body of a request, in which unknown keys are errors."""


class RecordBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a recording, which ends at the first limit that is reached."""

    name: Name | None = None
    kind: Kind = "scene"
    frames: Annotated[
        int,
        msgspec.Meta(
            ge=0,
            le=1_000_000_000,
            description="Number of frames after which the recording ends, for kind bands of each "
            "LED. 0 means no limit.",
        ),
    ] = 0
    seconds: (
        Annotated[
            float,
            msgspec.Meta(gt=0, le=1e7, description="Seconds after which the recording ends."),
        ]
        | None
    ) = None
    note: Annotated[
        str, msgspec.Meta(max_length=1000, description="Note that is kept in the recording.")
    ] = ""
    until_depth_std: (
        Annotated[
            float,
            msgspec.Meta(
                gt=0,
                le=1000,
                description="Standard deviation of depth, in metres, that ends the recording once "
                "enough pixels have reached it. This needs a calibration.",
            ),
        ]
        | None
    ) = None
    until_reflectance_std: (
        Annotated[
            float,
            msgspec.Meta(
                gt=0,
                le=1000,
                description="Standard deviation of the reflectance in every band that ends the "
                "recording once enough pixels have reached it. This needs a calibration.",
            ),
        ]
        | None
    ) = None
    share: Annotated[
        float,
        msgspec.Meta(
            gt=0,
            le=1,
            description="Fraction of the pixels that must reach the standard deviations.",
        ),
    ] = 0.9


class RenameBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is changed of a recording."""

    name: Annotated[
        str,
        msgspec.Meta(pattern=NAME_PATTERN, description="Name that the recording is given."),
    ]


class PictureBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How live pictures are made from now on; what is not given stays as it is."""

    frames: (
        Annotated[
            int,
            msgspec.Meta(
                ge=0,
                le=10_000_000,
                description="Number of frames behind each picture at least, rounded up to a "
                "multiple of those from one picture to the next. 0 restores what the daemon's "
                "configuration says.",
            ),
        ]
        | msgspec.UnsetType
    ) = msgspec.UNSET
    integration_s: (
        Annotated[
            float,
            msgspec.Meta(
                ge=0,
                le=LONGEST_S,
                description="Longest time in seconds over which photons of a pixel add up while it "
                "does not change; null for no limit, 0 for the newest frames alone.",
            ),
        ]
        | msgspec.UnsetType
        | None
    ) = msgspec.UNSET
    method: (
        Annotated[str, msgspec.Meta(description="Method of reconstruction.")] | msgspec.UnsetType
    ) = msgspec.UNSET


class CalibrateBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of the captures of a calibration."""

    distance: Annotated[
        float,
        msgspec.Meta(gt=0, le=1000, description="Distance of the reference target, in metres."),
    ]
    frames: Annotated[
        int, msgspec.Meta(ge=1, le=10_000_000, description="Number of frames of each capture.")
    ] = 4000
    bands: Annotated[
        bool,
        msgspec.Meta(description="Also capture the reference target with one LED at a time."),
    ] = True
    dark: Annotated[bool, msgspec.Meta(description="Also take a capture with all LEDs off.")] = (
        False
    )


_Unset = msgspec.UnsetType
_Index = Annotated[int, msgspec.Meta(ge=0, le=65535)]
Span = Annotated[
    tuple[_Index, _Index], msgspec.Meta(description="The first and the last one that is sent.")
]
Pixels = Annotated[
    tuple[tuple[_Index, _Index], ...],
    msgspec.Meta(max_length=4096, description="Row and column of each pixel that is not sent."),
]
Rate = Annotated[float, msgspec.Meta(gt=0, le=1e6, description="Frames per second.")]


class ControlsBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What of the camera is changed; null for the default, and nothing for no change."""

    rate_hz: Rate | _Unset | None = msgspec.UNSET
    rows: Span | _Unset | None = msgspec.UNSET
    cols: Span | _Unset | None = msgspec.UNSET
    gate: Span | _Unset | None = msgspec.UNSET
    masked: Pixels | _Unset | None = msgspec.UNSET


class SimulationBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is done to a simulated camera."""

    plugged: Annotated[
        bool, msgspec.Meta(description="False to pull its cable, true to plug it in again.")
    ]


class PixelQuery(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Coordinates of a pixel."""

    row: Annotated[int, msgspec.Meta(ge=0, le=1023, description="Row of the pixel, from 0.")]
    col: Annotated[int, msgspec.Meta(ge=0, le=1023, description="Column of the pixel, from 0.")]


@dataclass(frozen=True)
class Named:
    """Argument of an operation on a recording.

    Attributes
    ----------
    name : str
        Name of the recording, from the path.
    body : Body or None
        Decoded body.
    """

    name: str
    body: Any


@dataclass(frozen=True)
class Operation:
    """One operation of the API.

    Attributes
    ----------
    method : str
        HTTP method.
    path : str
        Path of the request.
    name : str
        Identifier of the operation, which is unique.
    summary : str
        One line for the OpenAPI description.
    result : str
        What a successful answer holds, for the OpenAPI description.
    action : callable
        Carries the operation out, given the service and the decoded body or query, or a `Named` if
        the path holds the name of a recording.
    body : type or None
        Type of the body; None for no body.
    query : type or None
        Type of the query; None for no query.
    conflicts : bool
        True if the operation can conflict with another one in progress (status 409).
    missing : bool
        True if the object of the operation may not exist (status 404).
    """

    method: Literal["GET", "POST", "PATCH", "DELETE"]
    path: str
    name: str
    summary: str
    result: str
    action: Callable[[Service, Any], dict[str, Any]]
    body: type[Body] | None = None
    query: type[Body] | None = None
    conflicts: bool = False
    missing: bool = False

    @property
    def named(self) -> bool:
        """True if the path holds the name of a recording."""
        return "{name}" in self.path


def _status(service: Service, _: None) -> dict[str, Any]:
    return service.status()


def _instrument(service: Service, _: None) -> dict[str, Any]:
    return service.describe()


def _start(service: Service, _: None) -> dict[str, Any]:
    service.start()
    return {"state": service.acquisition.snapshot.state}


def _stop(service: Service, _: None) -> dict[str, Any]:
    service.stop()
    return {"state": service.acquisition.snapshot.state}


def _picture(service: Service, body: PictureBody) -> dict[str, Any]:
    seconds: float | msgspec.UnsetType = (
        math.inf if body.integration_s is None else body.integration_s
    )
    chosen = {"frames": body.frames, "integration_s": seconds, "method": body.method}
    frames, number = service.change_pictures(
        **{name: value for name, value in chosen.items() if value is not msgspec.UNSET}
    )
    settings = service.pictures.settings
    return {
        "frames": frames,
        "number": number,
        "integration_s": settings.integration_s,
        "method": settings.method,
    }


def _record(service: Service, body: RecordBody) -> dict[str, Any]:
    limits = (body.until_depth_std, body.until_reflectance_std)
    until = None
    if limits != (None, None):
        until = StopRule(depth_std=limits[0], reflectance_std=limits[1], share=body.share)
    name = service.recording_job.begin(
        name=body.name or "",
        kind=body.kind,
        frames=body.frames,
        seconds=body.seconds,
        note=body.note,
        until=until,
    )
    return {"name": name}


def _stop_recording(service: Service, _: None) -> dict[str, Any]:
    return {"name": service.recording_job.end()}


def _recordings(service: Service, _: None) -> dict[str, Any]:
    # read first: a recording that is being finished has no summary yet, though its files are whole
    busy = service.finisher.busy
    return {
        "recordings": [
            entry | {"finished": entry["finished"] and entry["name"] not in busy}
            for entry in service.folder.listing()
        ]
    }


def _rename_recording(service: Service, named: Named) -> dict[str, Any]:
    service.rename_recording(named.name, named.body.name)
    return {"name": named.body.name}


def _delete_recording(service: Service, named: Named) -> dict[str, Any]:
    service.delete_recording(named.name)
    return {"name": named.name}


def _controls(service: Service, _: None) -> dict[str, Any]:
    return service.controls()


def _set_controls(service: Service, body: ControlsBody) -> dict[str, Any]:
    changes = {
        name: value
        for name in body.__struct_fields__
        if (value := getattr(body, name)) is not msgspec.UNSET
    }
    if changes.get("masked", ()) is None:
        changes["masked"] = ()
    service.set_controls(**changes)
    return service.controls()


def _simulate(service: Service, body: SimulationBody) -> dict[str, Any]:
    service.simulated_part.plug(body.plugged)
    return service.simulated_part.status() or {}


def _calibrate(service: Service, body: CalibrateBody) -> dict[str, Any]:
    job = service.calibration_job
    job.begin(distance=body.distance, frames=body.frames, bands=body.bands, dark=body.dark)
    return {"step": job.state.step}


def _cancel_calibration(service: Service, _: None) -> dict[str, Any]:
    service.calibration_job.cancel()
    return {"step": service.calibration_job.state.step}


def _pixel(service: Service, query: PixelQuery) -> dict[str, Any]:
    pictures = service.pictures
    return inspect(
        pictures.latest, service.instrument, pictures.calibration, row=query.row, col=query.col
    )


OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "GET",
        "/api/status",
        "status",
        "Get the current status",
        "State of the camera, totals, frames lost, rates, recording and calibration.",
        _status,
    ),
    Operation(
        "GET",
        "/api/instrument",
        "instrument",
        "Get the instrument",
        "Bands, geometry and period of the instrument.",
        _instrument,
    ),
    Operation(
        "POST",
        "/api/start",
        "start",
        "Start the live run",
        "State before the run.",
        _start,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/stop",
        "stop",
        "End the present run and stay idle",
        "State before the run has ended.",
        _stop,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/picture",
        "picture",
        "Begin a live picture anew, of photons that come from now on",
        "Number of frames that each picture has at least, number of the latest picture that may "
        "hold older photons, and how pictures are made.",
        _picture,
        body=PictureBody,
    ),
    Operation(
        "POST",
        "/api/recordings",
        "record",
        "Begin a recording",
        "Name of the recording.",
        _record,
        body=RecordBody,
        conflicts=True,
    ),
    Operation(
        "GET",
        "/api/recordings",
        "recordings",
        "List the finished recordings",
        "Name, size, duration, frames, losses, note, calibration and failure of each recording, "
        "newest first.",
        _recordings,
    ),
    Operation(
        "PATCH",
        "/api/recordings/{name}",
        "rename_recording",
        "Rename a recording",
        "New name of the recording.",
        _rename_recording,
        body=RenameBody,
        conflicts=True,
        missing=True,
    ),
    Operation(
        "DELETE",
        "/api/recordings/{name}",
        "delete_recording",
        "Delete a recording with all its files",
        "Name of the recording that was deleted.",
        _delete_recording,
        conflicts=True,
        missing=True,
    ),
    Operation(
        "POST",
        "/api/recordings/stop",
        "stop_recording",
        "End the recording in progress",
        "Name of the recording.",
        _stop_recording,
        conflicts=True,
    ),
    Operation(
        "GET",
        "/api/controls",
        "controls",
        "Get what of the camera may be changed",
        "Frame rate, region, time gate and masked pixels as they are, and their limits.",
        _controls,
    ),
    Operation(
        "POST",
        "/api/controls",
        "set_controls",
        "Change frame rate, region, time gate or masked pixels; the live run begins again",
        "Controls as they are now.",
        _set_controls,
        body=ControlsBody,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/simulation",
        "simulate",
        "Unplug a simulated camera, or plug it in again",
        "Whether it is plugged in, its distinct frames, and those repeated for want of time.",
        _simulate,
        body=SimulationBody,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/calibration",
        "calibrate",
        "Take the captures of a calibration, compute it and use it",
        "First step of the calibration; the status shows its progress.",
        _calibrate,
        body=CalibrateBody,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/calibration/cancel",
        "cancel_calibration",
        "Cancel the calibration in progress; the one in use stays in use",
        "Step that was cancelled.",
        _cancel_calibration,
        conflicts=True,
    ),
    Operation(
        "GET",
        "/api/pixel",
        "pixel",
        "Get one pixel of the latest picture",
        "Histogram, depth, reflectance in each band and quality of the pixel.",
        _pixel,
        query=PixelQuery,
        missing=True,
    ),
)
