"""What the API can do: one table, from which both the routes and the OpenAPI description come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec

from hueflight.daemon.pixel import inspect
from hueflight.daemon.service import Service
from hueflight.reconstruction.stopping import StopRule

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Kind = Literal["scene", "reference", "bands", "dark", "flat"]


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request's body, strict."""


class RecordBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Begin a recording."""

    name: Name | None = None
    kind: Kind = "scene"
    frames: Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)] = 0
    seconds: Annotated[float, msgspec.Meta(gt=0, le=1e7)] | None = None
    note: Annotated[str, msgspec.Meta(max_length=1000)] = ""
    until_depth_std: Annotated[float, msgspec.Meta(gt=0, le=1000)] | None = None
    until_reflectance_std: Annotated[float, msgspec.Meta(gt=0, le=1000)] | None = None
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.9


class CalibrateBody(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Take the captures of a calibration."""

    distance: Annotated[float, msgspec.Meta(gt=0, le=1000)]
    frames: Annotated[int, msgspec.Meta(ge=1, le=10_000_000)] = 4000
    bands: bool = True
    dark: bool = False


class PixelQuery(Body, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which pixel."""

    row: Annotated[int, msgspec.Meta(ge=0, le=1023)]
    col: Annotated[int, msgspec.Meta(ge=0, le=1023)]


@dataclass(frozen=True)
class Operation:
    """One thing that a client can ask for.

    Attributes
    ----------
    method, path : of the request.
    name : unique.
    summary : one line.
    action : does it; given the service and the decoded body or query.
    body, query : their types, None for none.
    conflicts : whether it can be refused for what goes on already (409).
    missing : whether what is asked for may not exist (404).
    """

    method: Literal["GET", "POST"]
    path: str
    name: str
    summary: str
    action: Callable[[Service, Any], dict[str, Any]]
    body: type[Body] | None = None
    query: type[Body] | None = None
    conflicts: bool = False
    missing: bool = False


def _start(service: Service, _: None) -> dict[str, Any]:
    service.start()
    return {"state": service.acquisition.snapshot.state}


def _stop(service: Service, _: None) -> dict[str, Any]:
    service.stop()
    return {"state": service.acquisition.snapshot.state}


def _record(service: Service, body: RecordBody) -> dict[str, Any]:
    wishes = (body.until_depth_std, body.until_reflectance_std)
    until = None
    if wishes != (None, None):
        until = StopRule(depth_std=wishes[0], reflectance_std=wishes[1], share=body.share)
    name = service.record(
        name=body.name or "",
        kind=body.kind,
        frames=body.frames,
        seconds=body.seconds,
        note=body.note,
        until=until,
    )
    return {"name": name}


def _stop_recording(service: Service, _: None) -> dict[str, Any]:
    return {"name": service.stop_recording()}


def _recordings(service: Service, _: None) -> dict[str, Any]:
    return {"recordings": service.folder.listing()}


def _calibrate(service: Service, body: CalibrateBody) -> dict[str, Any]:
    service.calibrating.begin(
        distance=body.distance, frames=body.frames, bands=body.bands, dark=body.dark
    )
    return {"step": service.calibrating.state.step}


def _pixel(service: Service, query: PixelQuery) -> dict[str, Any]:
    pictures = service.pictures
    return inspect(
        pictures.latest, service.instrument, pictures.calibration, row=query.row, col=query.col
    )


OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "GET", "/api/status", "status", "How things stand", lambda service, _: service.status()
    ),
    Operation(
        "GET",
        "/api/instrument",
        "instrument",
        "Bands, geometry and period of the instrument",
        lambda service, _: service.describe(),
    ),
    Operation("POST", "/api/start", "start", "Acquire live", _start),
    Operation("POST", "/api/stop", "stop", "End the present run and stay idle", _stop),
    Operation(
        "POST", "/api/recordings", "record", "Begin a recording", _record,
        body=RecordBody, conflicts=True,
    ),
    Operation("GET", "/api/recordings", "recordings", "Finished recordings", _recordings),
    Operation(
        "POST", "/api/recordings/stop", "stop_recording", "End the recording that is being made",
        _stop_recording, conflicts=True,
    ),
    Operation(
        "POST", "/api/calibration", "calibrate", "Take the captures of a calibration and use it",
        _calibrate, body=CalibrateBody, conflicts=True,
    ),
    Operation(
        "GET", "/api/pixel", "pixel", "One pixel of the latest picture in numbers", _pixel,
        query=PixelQuery, missing=True,
    ),
)  # fmt: skip
