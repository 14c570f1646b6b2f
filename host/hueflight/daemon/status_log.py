# SPDX-License-Identifier: Apache-2.0
"""Changes of the daemon's status as lines of a log, for programs that show a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Level = Literal["Info", "Warning", "Error"]


@dataclass(frozen=True)
class StatusLine:
    """One line of the log.

    Attributes
    ----------
    level : str
        ``"Info"``, ``"Warning"`` or ``"Error"``.
    text : str
        The line.
    """

    level: Level
    text: str


def status_lines(now: Mapping[str, Any], before: Mapping[str, Any] | None, /) -> list[StatusLine]:
    """Return what has changed in the daemon's status.

    Parameters
    ----------
    now : mapping
        The status, as `hueflight.daemon.service.Service.status` returns it.
    before : mapping or None
        An earlier status; None to describe the present one.

    Returns
    -------
    list of StatusLine
        State of the camera, problem, lost frames, recording and calibration, as far as changed.
    """
    found = [
        (line_of(now), None if before is None else line_of(before))
        for line_of in (_state, _problem, _losses, _recording, _calibration)
    ]
    return [line for line, earlier in found if line is not None and line != earlier]


def _state(status: Mapping[str, Any]) -> StatusLine:
    level: Level = "Error" if status["state"] in ("failed", "disconnected") else "Info"
    simulated = ", simulated" if status["simulated"] else ""
    return StatusLine(level, f"{status['instrument']}{simulated}: {status['state']}")


def _problem(status: Mapping[str, Any]) -> StatusLine | None:
    return StatusLine("Error", status["problem"]) if status["problem"] else None


def _losses(status: Mapping[str, Any]) -> StatusLine:
    lost = {place: count for place, count in status["lost"].items() if count}
    if not lost:
        return StatusLine("Info", "no frames lost")
    places = ", ".join(f"{place} {count}" for place, count in lost.items())
    return StatusLine("Warning", f"{sum(lost.values())} frames lost: {places}")


def _recording(status: Mapping[str, Any]) -> StatusLine | None:
    recording = status["recording"]
    if recording["name"]:
        return StatusLine("Info", f"recording {recording['name']}")
    last = recording["last"]
    if not last.get("name"):
        return None
    if last.get("failure"):
        return StatusLine("Error", f"recording {last['name']} failed: {last['failure']}")
    return StatusLine("Info", f"recording {last['name']} ended")


def _calibration(status: Mapping[str, Any]) -> StatusLine | None:
    calibration = status["calibration"]
    if not calibration["message"]:
        return StatusLine("Info", "no calibration: pictures show photons only")
    level: Level = "Error" if calibration["step"] == "failed" else "Info"
    return StatusLine(level, f"calibration: {calibration['message']}")
