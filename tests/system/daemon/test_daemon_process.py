# SPDX-License-Identifier: Apache-2.0
"""The daemon on real USB stacks: the camera comes and goes, clients misbehave, it is killed."""

from __future__ import annotations

import json
import signal
import socket
import urllib.parse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hueflight.emulation import CameraModel
from hueflight.recording import open_recording, recover
from support.daemon_process import Daemon, until

Start = Callable[[], Daemon]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


def test_the_camera_comes_and_goes(start_daemon: Start, bus: Any, model: CameraModel) -> None:
    """Frames delivered and frames lost add up to the frames the camera took."""
    daemon = start_daemon()
    until(lambda: daemon.status()["totals"]["delivered"] > 300, "frames come")
    for times in (1, 2):
        bus.unplug()
        until(lambda: daemon.status()["state"] == "disconnected", "the loss is noticed")
        found = daemon.status()
        assert found["problem"]
        until(lambda: daemon.status()["picture"]["stale"], "the picture is called stale")
        bus.plug()
        until(lambda: daemon.status()["state"] == "running", "it is back")
        until(lambda: not daemon.status()["picture"]["stale"], "pictures come again")
        assert len(daemon.status()["gaps"]) == times
    daemon.post("/api/stop")
    until(lambda: daemon.status()["state"] == "idle", "the run has ended")
    found = daemon.status()
    lost = found["lost"]
    assert found["totals"]["exposed"] == model.sent.frames
    assert found["totals"]["delivered"] + sum(lost.values()) == model.sent.frames
    assert lost["usb"] > 0
    assert lost["fpga"] == lost["host"] == lost["sensor"] == lost["disk"] == 0


def test_an_end_that_finishes_the_recording(start_daemon: Start, tmp_path: Path) -> None:
    daemon = start_daemon()
    daemon.post("/api/recordings", {"name": "last"})
    until(lambda: daemon.status()["recording"]["frames"] > 300, "frames are recorded")
    code, log = daemon.end(signal.SIGTERM)
    assert code in (0, -signal.SIGTERM)
    events = [json.loads(line)["event"] for line in log.splitlines() if line.startswith("{")]
    assert events[-1] == "ended"
    assert "recording ended" in events
    summary = json.loads((tmp_path / "data/recordings/last.json").read_text())
    assert summary["recorded_frames"] == summary["delivered"] > 300
    with open_recording(tmp_path / "data/recordings/last.mcap") as recording:
        assert recording.info().as_dict()["report"]["frames"] == summary["delivered"]


def test_killed_while_recording(start_daemon: Start, tmp_path: Path) -> None:
    """What was told to be on disk is on disk; the next daemon begins as if nothing had been."""
    daemon = start_daemon()
    daemon.post("/api/recordings", {"name": "cut"})
    until(lambda: daemon.status()["recording"]["frames"] > 300, "frames are on disk")
    told = daemon.status()["recording"]["frames"]
    daemon.end(signal.SIGKILL)
    found = recover(tmp_path / "data/recordings/cut.mcap", tmp_path / "saved.mcap")
    assert found is not None
    with open_recording(tmp_path / "saved.mcap") as recording:
        assert recording.info().as_dict()["report"]["frames"] >= told
    again = start_daemon()
    until(lambda: again.status()["totals"]["delivered"] > 100, "a new daemon acquires")


def test_slow_and_hostile_clients_cost_no_frame(start_daemon: Start, model: CameraModel) -> None:
    daemon = start_daemon()
    until(lambda: daemon.status()["totals"]["delivered"] > 100, "frames come")
    host, port = urllib.parse.urlsplit(daemon.url).netloc.split(":")
    attacks = []
    for number in range(30):
        attack = socket.create_connection((host, int(port)))
        if number % 3 == 0:  # begins a request and never ends it
            attack.sendall(b"GET /api/status HTTP/1.1\r\nHost: ")
        elif number % 3 == 1:  # a viewer that never reads
            attack.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            attack.sendall(
                f"GET /api/live HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
                "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
        else:  # noise
            attack.sendall(bytes(range(256)) * 64)
        attacks.append(attack)
    before = daemon.status()["totals"]["delivered"]
    until(lambda: daemon.status()["totals"]["delivered"] > before + 1500, "frames still come")
    found = daemon.status()
    assert found["viewers"] <= 8
    for attack in attacks:
        attack.close()
    daemon.post("/api/stop")
    until(lambda: daemon.status()["state"] == "idle", "the run has ended")
    found = daemon.status()
    assert found["totals"]["delivered"] == found["totals"]["exposed"] == model.sent.frames


def test_two_daemons_on_one_port(start_daemon: Start, tmp_path: Path) -> None:
    first = start_daemon()
    port = first.url.rpartition(":")[2]
    config = tmp_path / "daemon.toml"
    config.write_text(config.read_text().replace("port = 0", f"port = {port}"))
    with pytest.raises(AssertionError, match="is another daemon running"):
        start_daemon()
    assert first.status()["state"] in ("running", "idle", "disconnected")
