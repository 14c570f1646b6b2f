# SPDX-License-Identifier: Apache-2.0
"""Operations on the cameras of several daemons together."""

from __future__ import annotations

from typing import Any

import msgspec

from hueflight.daemon.cameras import Ask
from hueflight.daemon.http.answers import CamerasAnswer, TogetherAnswer
from hueflight.daemon.http.bodies import CamerasBody
from hueflight.daemon.http.camera_operations import CAMERA_OPERATIONS
from hueflight.daemon.http.operation import Operation
from hueflight.daemon.http.recording_operations import RECORDING_OPERATIONS
from hueflight.daemon.service import Service

#: operations of one camera, by method and path
_OF_ONE = {(each.method, each.path): each for each in (*CAMERA_OPERATIONS, *RECORDING_OPERATIONS)}


def _own(service: Service) -> Ask:
    """Requests to this daemon itself, as `Cameras` sends them to the others."""

    def ask(method: str, path: str, body: dict[str, Any] | None) -> dict[str, Any]:
        operation = _OF_ONE[method, path]
        decoded = None if operation.body is None else msgspec.convert(body, operation.body)
        answer = operation.action(service, decoded)
        assert isinstance(answer, dict)  # no picture is asked for
        return answer

    return ask


def _cameras(service: Service, _: None) -> dict[str, Any]:
    return {"cameras": service.cameras.listing(_own(service))}


def _act(service: Service, body: CamerasBody) -> dict[str, Any]:
    wanted = {"name": body.name, "frames": body.frames or None, "seconds": body.seconds}
    recorded = {name: value for name, value in wanted.items() if value is not None}
    return service.cameras.act(
        body.action, recorded if body.action == "record" else None, _own(service)
    )


SEVERAL_CAMERAS_OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "GET",
        "/api/cameras",
        "cameras",
        "List the cameras of this daemon and of those that its configuration names",
        "Address of each daemon, empty for this one, facts about its instrument, and the reason if "
        "they are not known.",
        _cameras,
        answer=CamerasAnswer,
    ),
    Operation(
        "POST",
        "/api/cameras",
        "act_together",
        "Start, stop or record all these cameras at the same time",
        "Answer or error of each camera, and the seconds within which all have answered.",
        _act,
        answer=TogetherAnswer,
        body=CamerasBody,
    ),
)
