# SPDX-License-Identifier: Apache-2.0
"""Operations on recordings."""

from __future__ import annotations

from typing import Any

from hueflight.daemon.http.answers import NameAnswer, RecordingsAnswer
from hueflight.daemon.http.bodies import RecordBody, RenameBody
from hueflight.daemon.http.operation import Named, Operation
from hueflight.daemon.service import Service
from hueflight.reconstruction.stopping import StopRule


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


def _stop_recording(service: Service, _: None) -> dict[str, Any]:
    return {"name": service.recording_job.end()}


RECORDING_OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "POST",
        "/api/recordings",
        "record",
        "Begin a recording",
        "Name of the recording.",
        _record,
        answer=NameAnswer,
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
        answer=RecordingsAnswer,
    ),
    Operation(
        "PATCH",
        "/api/recordings/{name}",
        "rename_recording",
        "Rename a recording",
        "New name of the recording.",
        _rename_recording,
        answer=NameAnswer,
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
        answer=NameAnswer,
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
        answer=NameAnswer,
        conflicts=True,
    ),
)
