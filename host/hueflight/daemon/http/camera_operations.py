# SPDX-License-Identifier: Apache-2.0
"""Operations on the daemon's own camera and its live pictures."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from hueflight.daemon.http.answers import (
    ControlsAnswer,
    InstrumentAnswer,
    PictureAnswer,
    PixelAnswer,
    SimulationAnswer,
    StateAnswer,
    Status,
)
from hueflight.daemon.http.bodies import (
    Body,
    ControlsBody,
    MaterialQuery,
    PictureBody,
    PixelQuery,
    ScheduleBody,
    SimulationBody,
)
from hueflight.daemon.http.operation import Operation
from hueflight.daemon.pixel import inspect
from hueflight.daemon.service import Service
from hueflight.model.schedules import Schedule


def _given(body: Body) -> dict[str, Any]:
    """What a body states of what may be left out."""
    return {
        name: value
        for name in body.__struct_fields__
        if (value := getattr(body, name)) is not msgspec.UNSET
    }


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
    settings, reduced = service.pictures.settings, service.pictures.reduced
    return {
        "frames": frames,
        "number": number,
        "integration_s": settings.integration_s,
        "method": "sums" if reduced else settings.method,
    }


def _pixel(service: Service, query: PixelQuery) -> dict[str, Any]:
    pictures = service.pictures
    return inspect(
        pictures.latest,
        service.instrument,
        pictures.calibration,
        row=query.row,
        col=query.col,
        materials=service.materials,
    )


def _materials(service: Service, query: MaterialQuery) -> bytes:
    return service.materials.message(service.pictures.latest, query.name)


def _controls(service: Service, _: None) -> dict[str, Any]:
    return service.controls()


def _set_controls(service: Service, body: ControlsBody) -> dict[str, Any]:
    changes = _given(body)
    if changes.get("masked", ()) is None:
        changes["masked"] = ()
    if isinstance(wanted := changes.get("schedule"), ScheduleBody):
        changes["schedule"] = _schedule(service, wanted)
    service.set_controls(**changes)
    return service.controls()


def _schedule(service: Service, body: ScheduleBody) -> Schedule:
    delays = tuple(each if isinstance(each, tuple) else (each,) for each in body.delays_ns)
    period_ns = body.period_ns
    return Schedule(
        delays, Schedule.of(service.stated).period_ns if period_ns is None else period_ns
    )


def _simulate(service: Service, body: SimulationBody) -> dict[str, Any]:
    service.simulated_part.change(**_given(body))
    return service.simulated_part.status() or {}


CAMERA_OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "GET",
        "/api/status",
        "status",
        "Get the current status",
        "State of the camera, totals, frames lost, rates, recording and calibration.",
        _status,
        answer=Status,
    ),
    Operation(
        "GET",
        "/api/instrument",
        "instrument",
        "Get the instrument",
        "Bands, geometry and period of the instrument.",
        _instrument,
        answer=InstrumentAnswer,
    ),
    Operation(
        "POST",
        "/api/start",
        "start",
        "Start the live run",
        "State before the run.",
        _start,
        answer=StateAnswer,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/stop",
        "stop",
        "End the present run and stay idle",
        "State before the run has ended.",
        _stop,
        answer=StateAnswer,
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
        answer=PictureAnswer,
        body=PictureBody,
        conflicts=True,
    ),
    Operation(
        "GET",
        "/api/pixel",
        "pixel",
        "Get one pixel of the latest picture",
        "Histogram, depth, reflectance in each band and quality of the pixel.",
        _pixel,
        answer=PixelAnswer,
        query=PixelQuery,
        missing=True,
    ),
    Operation(
        "GET",
        "/api/materials",
        "materials",
        "Get the map of a material's abundance or of a spectral index",
        "Message with value and standard deviation in each pixel of the latest picture.",
        _materials,
        query=MaterialQuery,
        missing=True,
    ),
    Operation(
        "GET",
        "/api/controls",
        "controls",
        "Get what of camera and LEDs may be changed",
        "Schedule, frame rate, region, time gate and masked pixels as they are, and their limits.",
        _controls,
        answer=ControlsAnswer,
    ),
    Operation(
        "POST",
        "/api/controls",
        "set_controls",
        "Change schedule, rate, region, time gate or masked pixels; the live run begins again",
        "Controls as they are now.",
        _set_controls,
        answer=ControlsAnswer,
        body=ControlsBody,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/simulation",
        "simulate",
        "Unplug a simulated camera, move its scene, or let its delays drift",
        "Whether it is plugged in, its distinct frames, those repeated for want of time, and what "
        "moves and drifts.",
        _simulate,
        answer=SimulationAnswer,
        body=SimulationBody,
        conflicts=True,
    ),
)
