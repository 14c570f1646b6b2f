# SPDX-License-Identifier: Apache-2.0
"""A daemon's process with everything around it that can fail: bus, camera, disk, clock, clients."""

from __future__ import annotations

import signal
import time
import urllib.error
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hueflight as hf
from hueflight.emulation import CameraModel, FrameBank
from support.clock_faults import ClockFaults
from support.daemon_process import Daemon, until
from support.disk_faults import DiskFaults
from support.emulated_camera import EmulatedCamera
from support.fault_runs.plan import FaultPlan
from support.mounts import SmallDisk
from support.small_daemon import small_instrument
from support.usbfs import UsbfsBus

SMALL_MB, IMAGE_MB = 96, 96
BUFFER_BYTES = 64 << 20  #: of the camera: this machine's processors are shared with others
LATE_S = 2.0  #: within this time `/health` must tell of a fault


class Machine:
    """The process of one run and its surroundings.

    Attributes
    ----------
    told_s : time until `/health` told of each fault that it must tell of, by its name.
    names : names of the recordings that were begun.
    told : frames of each recording that were said to be recorded before its first fault.
    exact : False if frames were exposed that nobody could count.
    logs : log of each process.
    """

    def __init__(self, plan: FaultPlan, folder: Path, build: Path) -> None:
        self.plan, self.folder = plan, folder
        folder.mkdir(parents=True)
        self.data = folder / "data"
        self.instrument = small_instrument(
            folder, frame_rate_hz=plan.rate_hz, exposure_ms=min(1.0, 500 / plan.rate_hz)
        )
        sensor = hf.Instrument.load(self.instrument).sensor
        bank = FrameBank.random(sensor, occupancy=plan.occupancy, frames=16, seed=plan.seed)
        self.model = CameraModel(sensor, bank, buffer_bytes=BUFFER_BYTES)
        self.camera = EmulatedCamera(self.model)
        self.bus = UsbfsBus(folder / "bus", self.camera)
        self.disk_faults = DiskFaults(build, self.data, folder / "disk_control")
        self.clock = ClockFaults(build, folder / "clock_control")
        self.program_faults = folder / "program_faults"
        self.program_faults.mkdir()
        self.disk: SmallDisk | None = None
        if plan.disk != "folder":
            image = folder / "disk.img" if plan.disk == "image" else None
            self.disk = SmallDisk(self.data, IMAGE_MB if image else SMALL_MB, image)
        self.told_s: list[tuple[str, float]] = []
        self.names: list[str] = []
        self.told: dict[str, int] = {}
        self.ended_badly: set[str] = set()
        self.exact = True
        self.logs: list[str] = []
        self._daemon: Daemon | None = None

    def close(self) -> None:
        """Leave nothing behind but files."""
        if self._daemon is not None:
            _, log = self._daemon.end(signal.SIGKILL)
            self.logs.append(log)
        self.bus.close()
        if self.disk is not None:
            self.disk.unmount()

    # -- the process ----------------------------------------------------------------------------

    @property
    def daemon(self) -> Daemon:
        """The present process, or the last one."""
        assert self._daemon is not None, "the daemon was not started"
        return self._daemon

    def begin(self) -> None:
        """Plug the camera in, and start the first process."""
        self.bus.plug()
        self.start()

    def start(self) -> None:
        """Start the daemon, and wait until frames come."""
        plan, config = self.plan, self.folder / "daemon.toml"
        config.write_text(
            f'name = "fault run"\ninstrument = "{self.instrument}"\ndata = "{self.data}"\n'
            f"simulate = false\n{plan.options}\n[server]\nport = 0\nrequests_per_s = 1e5\n"
            f"burst = 100000\n{plan.server}\n[recording]\n{plan.recording}\n"
        )
        parts = (
            self.disk_faults.environment, self.clock.environment, self.bus.environment
        )  # fmt: skip
        environment = {name: value for part in parts for name, value in part.items()}
        environment["LD_PRELOAD"] = ":".join(part["LD_PRELOAD"] for part in parts)
        environment["OPENBLAS_NUM_THREADS"] = "1"
        self._daemon = Daemon(config, environment, faults=self.program_faults)
        self.frames_come()

    def end(self, number: int) -> None:
        """End the process, and keep its log."""
        code, log = self.daemon.end(number)
        self.logs.append(log)
        assert code in (0, -number), f"the daemon ended with code {code}"

    # -- what is expected of it -----------------------------------------------------------------

    def status(self) -> Any:
        return self.daemon.status()

    def frames_come(self) -> None:
        before = self.status()["totals"]["delivered"]
        until(lambda: self.status()["totals"]["delivered"] > before + 20, "frames come")

    def must_tell(self, fault: str, words: str = "") -> None:
        """Wait until `/health` tells of a fault, and note how long that took."""
        began_s = time.monotonic()

        def told() -> bool:
            code, content = self.daemon.health()
            return code == 503 and any(words in problem for problem in content["problems"])

        until(told, f"/health tells of {fault!r} ({words!r})")
        self.told_s.append((fault, time.monotonic() - began_s))

    def must_be_well(self) -> None:
        until(lambda: self.daemon.health()[0] == 200, "/health is well again")

    def must_go_on(self) -> None:
        """The recording goes on, and is ended: while it lacks frames, `/health` says so."""
        before = self.status()["recording"]["frames"]
        until(lambda: self.status()["recording"]["frames"] > before, "the recording goes on")
        self.end_recording()
        self.must_be_well()

    # -- recordings -----------------------------------------------------------------------------

    @property
    def recording(self) -> str:
        """Name of the recording in progress."""
        return self.status()["recording"]["name"]

    def record(self) -> None:
        """Begin a recording, unless one is in progress."""
        if self.recording:
            return
        name = f"r{len(self.names)}"
        self.daemon.post("/api/recordings", {"name": name})
        self.names.append(name)

        def begun() -> bool:
            found = self.status()["recording"]
            if not found["name"]:
                raise AssertionError(f"{name!r} did not begin: {found['last']}")
            return found["frames"] > 20

        until(begun, f"frames of {name!r} are recorded")

    def note_told(self) -> None:
        """Note how many frames are said to be on disk, before anything happens."""
        found = self.status()["recording"]
        if found["name"]:
            self.told.setdefault(found["name"], found["frames"])

    def end_recording(self) -> None:
        """End the recording in progress, if there is one."""
        name = self.recording
        if name and self.accepts("/api/recordings/stop"):
            self.has_ended(name)

    def has_ended(self, name: str) -> None:
        """Wait for the summary of a recording."""
        until(lambda: self.recording != name, f"{name!r} has ended")

    def accepts(self, path: str, body: object = None) -> bool:
        """Whether a request is carried out; False if it conflicts with what is in progress."""
        try:
            self.daemon.post(path, body)
        except urllib.error.HTTPError as error:
            if error.code != 409:
                raise AssertionError(f"{path}: {error.code}: {error.read()[:300]!r}") from None
            return False
        return True


Fault = Callable[[Machine, Any], None]
