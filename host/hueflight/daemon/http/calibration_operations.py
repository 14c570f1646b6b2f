# SPDX-License-Identifier: Apache-2.0
"""Operations that calibrate the camera, and check and correct its calibration."""

from __future__ import annotations

from typing import Any

from hueflight.daemon.http.answers import StepAnswer
from hueflight.daemon.http.bodies import CalibrateBody, CheckBody
from hueflight.daemon.http.operation import Operation
from hueflight.daemon.service import Service


def _calibrate(service: Service, body: CalibrateBody) -> dict[str, Any]:
    job = service.calibration_job
    job.begin(distance=body.distance, frames=body.frames, bands=body.bands, dark=body.dark)
    return {"step": job.state.step}


def _cancel_calibration(service: Service, _: None) -> dict[str, Any]:
    service.calibration_job.cancel()
    return {"step": service.calibration_job.state.step}


def _check(service: Service, body: CheckBody) -> dict[str, Any]:
    service.check_job.begin(kind=body.kind, frames=body.frames, distance=body.distance)
    return {"step": service.check_job.state.step}


def _correct(service: Service, _: None) -> dict[str, Any]:
    service.check_job.correct()
    return {"step": service.check_job.state.step}


CALIBRATION_OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "POST",
        "/api/calibration",
        "calibrate",
        "Take the captures of a calibration, compute it and use it",
        "First step of the calibration; the status shows its progress.",
        _calibrate,
        answer=StepAnswer,
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
        answer=StepAnswer,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/check",
        "check",
        "Take a capture and check with it whether the calibration in use still holds",
        "First step of the check; the status shows its progress and what was found.",
        _check,
        answer=StepAnswer,
        body=CheckBody,
        conflicts=True,
    ),
    Operation(
        "POST",
        "/api/check/correct",
        "correct",
        "Correct the calibration in use for the drift of LEDs that the last check found",
        "Step of the check, which is then done.",
        _correct,
        answer=StepAnswer,
        conflicts=True,
    ),
)
