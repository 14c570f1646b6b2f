# SPDX-License-Identifier: Apache-2.0
"""The books of a run: frames of the daemon, frames of each recording, and what is in the files."""

from __future__ import annotations

import json
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from hueflight.recording import open_recording
from hueflight_protocol.wire import FRAME_HEADER
from support.daemon_process import until
from support.fault_runs.machine import Machine


def check_totals(machine: Machine) -> dict[str, Any]:
    """Frames of the daemon's process, when it is idle; returns its status."""
    machine.daemon.post("/api/stop")
    until(lambda: _rests(machine), "the run has ended")
    found = machine.status()
    totals, lost = found["totals"], found["lost"]
    undelivered = sum(frames for place, frames in lost.items() if place != "disk")
    assert totals["exposed"] == totals["delivered"] + undelivered, f"{totals} {lost}"
    if machine.exact and all(gap["frames_lost"] is not None for gap in found["gaps"]):
        sent = machine.model.sent.frames
        assert totals["exposed"] == sent, f"{totals['exposed']} counted, {sent} exposed"
    if machine.plan.harmless:
        assert undelivered == 0, f"frames were lost: {lost}"
    return found


def _rests(machine: Machine) -> bool:
    """Whether nothing runs, nor is about to: a run that is just beginning may still end."""
    sent = machine.model.sent
    time.sleep(0.4)
    return machine.status()["state"] == "idle" and machine.model.sent == sent


def check_recordings(machine: Machine) -> int:
    """Each recording against its summary; returns the number of frames in all files."""

    def entries() -> list[dict[str, Any]]:
        return machine.daemon.get("/api/recordings")["recordings"]

    until(
        lambda: all(entry["finished"] and entry["frames"] is not None for entry in entries()),
        "all recordings are finished, and have their summaries",
    )
    listed = {entry["name"] for entry in entries()}
    frames = 0
    for name in machine.names:
        path = machine.data / "recordings" / f"{name}.mcap"
        if name not in listed:  # it ended before it began
            assert not path.exists()
            continue
        summary = json.loads(path.with_suffix(".json").read_text())
        frames += _check_recording(machine, name, path, summary)
    assert not list((machine.data / "recordings").glob("*.part"))
    return frames


def _check_recording(machine: Machine, name: str, path: Path, summary: dict[str, Any]) -> int:
    with open_recording(path) as recording:
        in_file = recording.frames
        photons = int(recording.histogram()[..., 1:].sum()) if in_file else 0
        places = [_place(packet) for packet in recording.packets()] if in_file else []
        assert recording.info().complete, name
    assert summary["recorded_frames"] == in_file, f"{name}: {summary}, {in_file} in the file"
    told = machine.told.get(name, 0)
    assert in_file >= told, f"{name}: {told} frames were said to be recorded, {in_file} are"
    if "lost" not in summary:  # cut off, and finished at the next start
        assert name in machine.ended_badly, f"{name}: {summary}"
        undelivered, on_disk = 1, 0
    else:
        lost = summary["lost"]
        on_disk = lost["disk"]
        undelivered = sum(lost.values()) - on_disk
        assert in_file + on_disk == summary["delivered"], f"{name}: {summary}"
        assert summary["exposed"] == summary["delivered"] + undelivered, f"{name}: {summary}"
        if on_disk == 0:
            assert photons == summary["photons"], f"{name}: {photons} photons, {summary}"
    assert len(places) == in_file
    if not undelivered:  # whole up to the fault
        assert [frame for _, frame in places[:told]] == list(range(told)), f"{name}: a hole"
    for (run, frame), (later_run, later) in pairwise(places):  # and nothing twice
        assert run != later_run or later > frame, f"{name}: frame {later} after {frame}"
    return in_file


def _place(packet: bytes) -> tuple[int, int]:
    """Label of a frame's run at the camera, and its number in it."""
    header = FRAME_HEADER.unpack(packet)
    return header["capture"], header["frame"]
