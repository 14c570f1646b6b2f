# SPDX-License-Identifier: Apache-2.0
"""The daemon as people run it: a process of its own on the emulated bus."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

import hueflight as hf
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.frame_bank import simulated_packets
from support.daemon_process import Daemon


@pytest.fixture(scope="session")
def instrument_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's instrument with few pixels, as a TOML file."""
    text = (resources.files("hueflight.model") / "presets" / "paper.toml").read_text("utf-8")
    text = re.sub(r"(?m)^rows = 192$", "rows = 48", text)
    text = re.sub(r"(?m)^cols = 128$", "cols = 32", text)
    # the same field of view with larger pixels
    text = text.replace("pixel_width_um = 18.4", "pixel_width_um = 73.6")
    text = text.replace("pixel_height_um = 9.2", "pixel_height_um = 36.8")
    path = tmp_path_factory.mktemp("instrument") / "small.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="session")
def banks(instrument_file: Path) -> dict[str, list[bytes]]:
    """Simulated frames of the scene and of the reference target."""
    text = hf.Instrument.load(instrument_file).to_json()
    return {
        kind: simulated_packets(kind, text, "fig1", 0.4, 400, 1) for kind in ("scene", "reference")
    }


@pytest.fixture
def model(instrument_file: Path, banks: dict[str, list[bytes]]) -> CameraModel:
    sensor = hf.Instrument.load(instrument_file).sensor
    return CameraModel(sensor, FrameBank(banks["scene"]))


@pytest.fixture
def bus(tmp_path: Path, model: CameraModel) -> Iterator[Any]:
    from support.emulated_camera import EmulatedCamera
    from support.emulation import require_packages
    from support.usbfs import UsbfsBus

    require_packages()
    made = UsbfsBus(tmp_path / "bus", EmulatedCamera(model))
    try:
        made.plug()
        yield made
    finally:
        made.close()


@pytest.fixture
def start_daemon(bus: Any, tmp_path: Path, instrument_file: Path) -> Iterator[Callable[[], Daemon]]:
    """Function that starts a daemon on the emulated bus; its data lie in tmp_path/data."""
    config = tmp_path / "daemon.toml"
    config.write_text(
        f'name = "test bench"\ninstrument = "{instrument_file}"\ndata = "{tmp_path}/data"\n'
        "simulate = false\n[server]\nport = 0\nrequests_per_s = 200\nburst = 400\n"
    )
    started: list[Daemon] = []

    def start() -> Daemon:
        started.append(Daemon(config, bus.environment))
        return started[-1]

    try:
        yield start
    finally:
        for daemon in started:
            daemon.end(signal.SIGKILL)


@pytest.fixture(scope="session")
def fast_instrument(instrument_file: Path) -> Path:
    """The small instrument at 4000 frames per second, which fills a small disk in seconds."""
    path = instrument_file.with_name("fast.toml")
    text = instrument_file.read_text()
    path.write_text(
        text.replace("frame_rate_hz = 480", "frame_rate_hz = 4000").replace(
            "exposure_ms = 1.0", "exposure_ms = 0.2"
        )
    )
    return path


@pytest.fixture
def start_simulated(tmp_path: Path, fast_instrument: Path) -> Iterator[Callable[..., Daemon]]:
    """Function that starts a daemon on a simulated camera; options override its configuration."""
    started: list[Daemon] = []

    def start(
        data: Path,
        *,
        environment: dict[str, str] | None = None,
        faults: Path | None = None,
        options: str = "",
        server: str = "",
        recording: str = "min_free_mb = 1",
    ) -> Daemon:
        config = tmp_path / "simulated.toml"
        config.write_text(
            f'name = "test bench"\ninstrument = "{fast_instrument}"\ndata = "{data}"\n'
            f'rig = "simulated:fig1?frames=64"\n{options}\n'
            f"[server]\nport = 0\nrequests_per_s = 200\nburst = 400\n{server}\n"
            f"[recording]\n{recording}\n"
        )
        started.append(Daemon(config, environment or {}, faults=faults))
        return started[-1]

    try:
        yield start
    finally:
        for daemon in started:
            daemon.end(signal.SIGKILL)
