# SPDX-License-Identifier: Apache-2.0
"""The daemon as people run it: a process of its own on the emulated bus."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import hueflight as hf
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.frame_bank import simulated_packets
from hueflight.simulator import simulate_capture
from support.browser import open_browser, require_chromium, wait
from support.daemon_process import PATIENCE_S, Daemon, until
from support.small_daemon import small_instrument


@pytest.fixture(scope="session")
def instrument_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's instrument with few pixels, as a TOML file."""
    return small_instrument(tmp_path_factory.mktemp("instrument"), rows=48, cols=32)


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
def fast_instrument(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small instrument at 4000 frames per second, which fills a small disk in seconds."""
    folder = tmp_path_factory.mktemp("instrument")
    return small_instrument(folder, rows=48, cols=32, frame_rate_hz=4000, exposure_ms=0.2)


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


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory, fast_instrument: Path) -> Iterator[Daemon]:
    """A calibrated daemon, whose data lie in the folder `daemon.data`."""
    require_chromium()
    folder = tmp_path_factory.mktemp("daemon")
    instrument = hf.Instrument.load(fast_instrument)
    reference = simulate_capture("reference", instrument, frames=4000, seed=5)
    kept = folder / "data/calibrations/20260101T000000Z"
    kept.mkdir(parents=True)
    hf.calibrate(reference, instrument, distance=0.4).save(kept / "calibration.zarr")
    config = folder / "daemon.toml"
    config.write_text(
        f'name = "test bench"\ninstrument = "{fast_instrument}"\ndata = "{folder}/data"\n'
        'rig = "simulated:fig1?frames=960"\n'
        "[server]\nport = 0\nrequests_per_s = 200\nburst = 400\n[recording]\nmin_free_mb = 1\n"
        '[materials]\nlibrary = "colorchecker"\nnames = ["red", "blue"]\nindices = ["NGRDI"]\n'
    )
    made = Daemon(config, {})
    made.data = folder / "data"  # pyright: ignore[reportAttributeAccessIssue]
    try:
        until(lambda: made.status()["kind"] == "live", "the live run is on")
        yield made
    finally:
        made.end(signal.SIGKILL)


@pytest.fixture
def page(daemon: Daemon, tmp_path: Path) -> Iterator[Any]:
    """The page of the daemon; errors in its console fail the test."""
    with open_browser(tmp_path / "profile") as browser:
        context = browser.new_context(viewport={"width": 1366, "height": 768})
        opened = context.new_page()
        opened.set_default_timeout(PATIENCE_S * 1e3)
        failures: list[str] = []
        opened.on("pageerror", lambda error: failures.append(str(error)))
        opened.goto(daemon.url)
        wait(opened, "#state", "live")
        opened.wait_for_selector("#hint", state="hidden")
        opened.focus("#view")
        opened.daemon = daemon
        yield opened
    assert not failures
