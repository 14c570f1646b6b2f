# SPDX-License-Identifier: Apache-2.0
"""Frame rate, region, time gate and mask: what is set is what the camera sends."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from hueflight.recording import open_recording
from hueflight_protocol import FrameFlags, decode_frame

WAIT_S = 60.0


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.02)


def status(client: TestClient) -> dict[str, Any]:
    return client.get("/api/status").json()


def recorded(client: TestClient, tmp_path: Path, name: str) -> Path:
    """A short recording, finished."""
    client.post("/api/recordings", json={"name": name, "frames": 200})
    until(lambda: status(client)["recording"]["last"].get("name") == name, "it has ended")
    return tmp_path / f"data/recordings/{name}.mcap"


@pytest.fixture
def running(client: TestClient) -> TestClient:
    until(lambda: status(client)["state"] == "running", "the live run is on")
    return client


def test_what_is_left_out_is_not_sent(running: TestClient, tmp_path: Path) -> None:
    """Region, gate and mask in every frame of a recording, and nothing else is changed."""
    before = recorded(running, tmp_path, "whole")
    changed = running.post(
        "/api/controls",
        json={"rows": [1, 4], "cols": [2, 6], "gate": [100, 300], "masked": [[1, 2], [4, 6]]},
    )
    assert changed.status_code == 200
    until(lambda: status(running)["state"] == "running", "the live run begins again")
    with open_recording(recorded(running, tmp_path, "part")) as recording:
        frames = [decode_frame(packet) for packet in recording.packets()]
        noted = json.loads(recording.info().metadata["controls"])
    assert (noted["rows"], noted["masked"]) == ([1, 4], [[1, 2], [4, 6]])
    with open_recording(before) as recording:
        whole = [decode_frame(packet) for packet in recording.packets()]
    keep = np.zeros((6, 8), bool)
    keep[1:5, 2:7] = True
    keep[1, 2] = keep[4, 6] = False
    seen = {frame.codes.tobytes() for frame in frames}
    expected = {
        np.where(keep & (f.codes >= 100) & (f.codes <= 300), f.codes, 0).tobytes() for f in whole
    }
    assert seen == expected  # the bank of 16 frames, each of them many times
    flags = FrameFlags.MASKED | FrameFlags.ROI | FrameFlags.GATED
    assert {frame.header.flags & flags for frame in frames} == {flags}
    reset = running.post("/api/controls", json=dict.fromkeys(("rows", "cols", "gate", "masked")))
    assert reset.json()["leaves_out"] is False
    with open_recording(recorded(running, tmp_path, "again")) as recording:
        again = {decode_frame(packet).codes.tobytes() for packet in recording.packets()}
    assert again == {frame.codes.tobytes() for frame in whole}


def test_the_frame_rate(running: TestClient, tmp_path: Path) -> None:
    """It is the device clock's, and pictures follow it."""
    limits = running.get("/api/controls").json()["limits"]
    low, high = limits["rate_hz"]
    assert low < 500 < high
    answer = running.post("/api/controls", json={"rate_hz": 500}).json()
    assert answer["rate_hz"] == 500
    until(
        lambda: running.get("/api/controls").json()["actual_rate_hz"] == pytest.approx(500, 1e-3),
        "the camera is set",
    )
    path = recorded(running, tmp_path, "slow")
    with open_recording(path) as recording:
        assert recording.info().seconds == pytest.approx(199 / 500, rel=1e-3)
    assert running.post("/api/controls", json={"rate_hz": None}).json()["rate_hz"] is None
    number = status(running)["picture"]["number"]
    until(lambda: status(running)["picture"]["number"] > number + 2, "pictures go on")


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"rows": [0, 6]}, "rows = [0, 6]: must be the first and the last one, from 0 to 5"),
        ({"cols": [4, 3]}, "cols = [4, 3]"),
        ({"gate": [0, 512]}, "gate = [0, 512]"),
        ({"masked": [[0, 8]]}, "pixel 0, 8 lies outside the sensor of 6 × 8"),
        ({"rate_hz": 0.01}, "must be at least"),
        ({"rate_hz": 900000}, "this camera takes at most"),
        ({"rate_hz": "fast"}, "rate_hz"),
        ({"rows": [1]}, "rows"),
        ({"speed": 1}, "speed"),
    ],
)
def test_values_out_of_range_are_refused(
    running: TestClient, body: dict[str, Any], words: str
) -> None:
    before = running.get("/api/controls").json()
    answer = running.post("/api/controls", json=body)
    assert answer.status_code == 422
    assert words in answer.json()["error"]
    assert running.get("/api/controls").json() == before


def test_nothing_is_changed_while_something_is_recorded(running: TestClient) -> None:
    running.post("/api/recordings", json={"name": "busy"})
    answer = running.post("/api/controls", json={"rate_hz": 100})
    assert answer.status_code == 409
    assert "'busy' is in progress" in answer.json()["error"]
    running.post("/api/recordings/stop")
    until(lambda: not status(running)["recording"]["name"], "it has ended")
    assert running.post("/api/controls", json={"rows": [0, 3]}).status_code == 200
    refused = running.post("/api/calibration", json={"distance": 0.4, "frames": 10})
    assert refused.status_code == 409
    assert "leaves out pixels" in refused.json()["error"]
