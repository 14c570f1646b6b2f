# SPDX-License-Identifier: Apache-2.0
"""Faults of disk and program under a running daemon: it says so, and accounts for every frame."""

from __future__ import annotations

import errno
import json
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hueflight.recording import open_recording
from support.daemon_process import Daemon, until
from support.disk_faults import DiskFaults
from support.mounts import SmallDisk, require_mounts

Start = Callable[..., Daemon]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


@pytest.fixture
def faults(tmp_path: Path) -> DiskFaults:
    return DiskFaults(tmp_path / "shim", tmp_path / "data")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[..., SmallDisk]]:
    require_mounts()
    made: list[SmallDisk] = []

    def mounted(size_mb: int, *, image: bool = False) -> SmallDisk:
        file = tmp_path / "disk.img" if image else None
        made.append(SmallDisk(tmp_path / "data", size_mb, file))
        return made[-1]

    yield mounted
    for disk in made:
        disk.unmount()


def begin_recording(daemon: Daemon, name: str, *, frames: int = 500) -> None:
    until(lambda: daemon.status()["state"] == "running", "the camera runs")
    daemon.post("/api/recordings", {"name": name})
    until(lambda: daemon.status()["recording"]["frames"] > frames, "frames are recorded")


def end_recording(daemon: Daemon) -> dict[str, Any]:
    """Its summary, whose books must balance."""
    name = daemon.post("/api/recordings/stop")["name"]
    until(lambda: daemon.status()["recording"]["last"].get("name") == name, "it has ended")
    last = daemon.status()["recording"]["last"]
    assert last["recorded_frames"] + last["lost"]["disk"] == last["delivered"]
    assert last["exposed"] == last["delivered"]
    assert sum(lost for place, lost in last["lost"].items() if place != "disk") == 0
    return last


def unhealthy(daemon: Daemon, words: str) -> None:
    """Wait until `/health` tells of a problem."""

    def told() -> bool:
        code, content = daemon.health()
        return code == 503 and any(words in problem for problem in content["problems"])

    until(told, f"/health says {words!r}")


def healthy(daemon: Daemon) -> None:
    until(lambda: daemon.health()[0] == 200, "/health is well again")


def frames_in(path: Path) -> int:
    with open_recording(path) as recording:
        counted = int(recording.histogram().sum(axis=-1).max())
        assert counted == recording.frames
        assert recording.info().complete
    return counted


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        ("write", errno.EIO, "Input/output error"),
        ("write", errno.ENOSPC, "No space left"),
        ("room", errno.EIO, "Input/output error"),
    ],
)
def test_an_error_while_recording(
    start_simulated: Start, faults: DiskFaults, tmp_path: Path, call: str, error: int, words: str
) -> None:
    """It concerns the recording alone, which goes on in a new segment when the disk is well."""
    daemon = start_simulated(tmp_path / "data", environment=faults.environment)
    begin_recording(daemon, "hit")
    faults.fail(call, error=error)
    unhealthy(daemon, words)
    found = daemon.status()
    assert found["recording"]["paused"]
    assert found["parts"]["recorder"]["state"] == "failed"
    assert found["parts"]["acquisition"]["state"] == "working"
    before = daemon.status()["recording"]["frames"]
    until(lambda: daemon.status()["lost"]["disk"] > 200, "losses are counted")
    faults.heal()
    until(lambda: daemon.status()["recording"]["frames"] > before + 500, "it goes on")
    last = end_recording(daemon)
    assert words in last["failure"]
    assert last["lost"]["disk"] > 200
    healthy(daemon)
    until(lambda: daemon.get("/api/recordings")["recordings"][0]["finished"], "it is finished")
    assert daemon.get("/api/recordings")["recordings"][0]["segments"] == 2
    assert frames_in(tmp_path / "data/recordings/hit.mcap") == last["recorded_frames"]


def test_an_error_as_a_recording_begins(
    start_simulated: Start, faults: DiskFaults, tmp_path: Path
) -> None:
    daemon = start_simulated(tmp_path / "data", environment=faults.environment)
    until(lambda: daemon.status()["totals"]["delivered"] > 100, "frames come")
    for call in ("create", "write", "room"):
        faults.fail(call)
        daemon.post("/api/recordings", {"name": f"never-{call}"})
        until(
            lambda name=f"never-{call}": daemon.status()["recording"]["last"].get("name") == name,
            "it has failed",
        )
        assert "Input/output error" in daemon.status()["recording"]["last"]["failure"]
        before = daemon.status()["totals"]["delivered"]
        until(
            lambda before=before: daemon.status()["totals"]["delivered"] > before + 500,
            "frames come",
        )
        faults.heal()
    assert daemon.status()["parts"]["acquisition"]["failures"] == 0
    healthy(daemon)


@pytest.mark.parametrize("call", ["sync", "rename"])
def test_an_error_as_a_recording_ends(
    start_simulated: Start, faults: DiskFaults, tmp_path: Path, call: str
) -> None:
    """Its frames are in an unfinished file, which the next start finishes."""
    daemon = start_simulated(tmp_path / "data", environment=faults.environment)
    begin_recording(daemon, "last")
    faults.fail(call)
    last = end_recording(daemon)
    assert "Input/output error" in last["failure"]
    before = daemon.status()["totals"]["delivered"]
    until(lambda: daemon.status()["totals"]["delivered"] > before + 500, "frames come")
    assert daemon.status()["parts"]["acquisition"]["failures"] == 0
    assert not daemon.get("/api/recordings")["recordings"][0]["finished"]
    daemon.end(signal.SIGTERM)
    faults.heal()
    again = start_simulated(tmp_path / "data", environment=faults.environment)
    until(lambda: again.get("/api/recordings")["recordings"][0]["finished"], "it is finished")
    assert frames_in(tmp_path / "data/recordings/last.mcap") == last["recorded_frames"]


def test_the_reserve_holds(
    start_simulated: Start, small_disk: Callable[..., SmallDisk], tmp_path: Path
) -> None:
    """At the threshold the recording pauses; with room again it goes on in a new segment."""
    import os

    disk = small_disk(64)
    ballast = disk.folder / "ballast"
    ballast.write_bytes(bytes(32 << 20))
    daemon = start_simulated(disk.folder, recording="min_free_mb = 16")
    begin_recording(daemon, "tight")
    unhealthy(daemon, "MiB are free")
    free = []
    until(lambda: daemon.status()["lost"]["disk"] > 4000, "losses are counted")
    for _ in range(50):
        found = os.statvfs(disk.folder)
        free.append(found.f_bavail * found.f_frsize)
        daemon.status()
    assert min(free) >= 16 << 20
    with_losses = daemon.status()["recording"]
    assert with_losses["paused"]
    frames = with_losses["frames"]
    ballast.unlink()
    until(lambda: daemon.status()["recording"]["frames"] > frames + 500, "it goes on")
    assert not daemon.status()["recording"]["paused"]
    last = end_recording(daemon)
    assert last["lost"]["disk"] > 4000
    assert frames_in(disk.folder / "recordings/tight.mcap") == last["recorded_frames"]
    with open_recording(disk.folder / "recordings/tight.mcap") as recording:
        report = recording.info().report
    assert report["damaged"] == report["missing"] == report["skipped_bytes"] == 0
    healthy(daemon)


def test_a_disk_that_is_unplugged(
    start_simulated: Start, small_disk: Callable[..., SmallDisk], tmp_path: Path
) -> None:
    """Nothing goes to the disk below the mount point; all before the fault is on the disk."""
    disk = small_disk(128, image=True)
    daemon = start_simulated(disk.folder)
    begin_recording(daemon, "pulled")
    disk.unmount()
    unhealthy(daemon, "mount")
    told = daemon.status()["recording"]["frames"]
    before = daemon.status()["totals"]["delivered"]
    until(lambda: daemon.status()["totals"]["delivered"] > before + 500, "acquisition goes on")
    assert list(disk.folder.iterdir()) == []
    disk.mount()
    until(lambda: daemon.status()["recording"]["frames"] > told + 500, "it goes on")
    last = end_recording(daemon)
    assert last["lost"]["disk"] > 0
    healthy(daemon)
    until(lambda: daemon.get("/api/recordings")["recordings"][0]["finished"], "it is finished")
    assert frames_in(disk.folder / "recordings/pulled.mcap") == last["recorded_frames"]


def test_a_recording_that_was_cut_off_is_finished(start_simulated: Start, tmp_path: Path) -> None:
    daemon = start_simulated(tmp_path / "data")
    begin_recording(daemon, "cut")
    told = daemon.status()["recording"]["frames"]
    daemon.end(signal.SIGKILL)
    again = start_simulated(tmp_path / "data")
    until(lambda: again.get("/api/recordings")["recordings"][0]["finished"], "it is finished")
    assert frames_in(tmp_path / "data/recordings/cut.mcap") >= told
    summary = json.loads((tmp_path / "data/recordings/cut.json").read_text())
    assert summary["recorded_frames"] >= told
    assert "ended during the recording" in summary["failure"]
    assert not list((tmp_path / "data/recordings").glob("*.part"))


@pytest.mark.parametrize("kind", ["", "transition"])
@pytest.mark.parametrize("part", ["acquisition", "pictures", "recorder"])
def test_no_part_dies_unnoticed(
    start_simulated: Start, tmp_path: Path, part: str, kind: str
) -> None:
    """The part begins anew; the others go on; page, log, metrics and health tell of it."""
    asked = tmp_path / "faults"
    asked.mkdir()
    daemon = start_simulated(tmp_path / "data", faults=asked)
    begin_recording(daemon, "hit")
    (asked / part).write_text(kind)
    unhealthy(daemon, "asked for")
    found = daemon.status()
    assert found["parts"][part]["state"] == "failed"
    assert "asked for" in found["problem"]
    assert (found["state"] == "failed") == (part == "acquisition")
    if part != "acquisition":
        end_recording(daemon)
    healthy(daemon)
    found = daemon.status()
    assert found["parts"][part] == {"state": "working", "problem": "", "failures": 1}
    before = found["totals"]["delivered"]
    until(lambda: daemon.status()["totals"]["delivered"] > before + 500, "frames come")
    until(lambda: not daemon.status()["picture"]["stale"], "pictures come")
    last = daemon.status()["recording"]["last"]
    assert last["recorded_frames"] + last["lost"]["disk"] == last["delivered"]
    assert ("asked for" in last["failure"]) == (part != "pictures")
    daemon.post("/api/recordings", {"name": "next", "frames": 500})
    until(lambda: daemon.status()["recording"]["last"].get("name") == "next", "it has ended")
    assert daemon.status()["recording"]["last"]["recorded_frames"] == 500
    _, log = daemon.end(signal.SIGTERM)
    assert "asked for" in log
    assert "Traceback" in log


def test_systemd_hears_of_a_daemon_that_hangs(start_simulated: Start, tmp_path: Path) -> None:
    """READY when it listens, and no more WATCHDOG once acquisition hangs."""
    asked = tmp_path / "faults"
    asked.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(30.0)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1000000"}
        daemon = start_simulated(tmp_path / "data", environment=environment, faults=asked)
        assert manager.recv(4096) == b"READY=1"
        assert manager.recv(4096).startswith(b"WATCHDOG=1")
        until(lambda: daemon.status()["totals"]["delivered"] > 100, "frames come")
        (asked / "acquisition").write_text("hang")
        unhealthy(daemon, "has not answered")
        assert daemon.status()["state"] == "failed"
        manager.settimeout(3.0)
        while True:
            try:
                manager.recv(4096)
            except TimeoutError:
                break  # silent for several intervals: systemd would start it anew
        (asked / "acquisition").unlink()
        healthy(daemon)
        assert manager.recv(4096).startswith(b"WATCHDOG=1")
        daemon.end(signal.SIGTERM)
        while not manager.recv(4096).startswith(b"STOPPING=1"):
            continue


def test_two_thousand_idle_connections(start_simulated: Start, tmp_path: Path) -> None:
    """They keep nobody out, take no file from the recording, and cost no frame."""
    import resource

    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limits[1] < 4096:
        pytest.skip("this user may not mount disks or open so many files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (512, limits[1]))  # the daemon inherits it
    try:
        daemon = start_simulated(tmp_path / "data")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limits[1], limits[1]))
    begin_recording(daemon, "flooded")
    host, port = daemon.url.removeprefix("http://").split(":")
    idle: list[socket.socket] = []
    try:
        for number in range(2000):
            sock = socket.socket()
            sock.settimeout(10.0)
            sock.connect((host, int(port)))
            if number % 2:
                sock.sendall(b"GET /health HTTP/1.1\r\n")
            idle.append(sock)
            if number % 500 == 250:
                assert daemon.health()[0] == 200
        open_files = len(list(Path(f"/proc/{daemon.process.pid}/fd").iterdir()))
        assert open_files < 300
        before = daemon.status()["recording"]["frames"]
        until(lambda: daemon.status()["recording"]["frames"] > before + 2000, "it goes on")
        last = end_recording(daemon)
    finally:
        for sock in idle:
            sock.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert last["failure"] == ""
    assert last["lost"]["disk"] == 0
    assert frames_in(tmp_path / "data/recordings/flooded.mcap") == last["delivered"]
