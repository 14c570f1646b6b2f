# SPDX-License-Identifier: Apache-2.0
"""A daemon as people run it, with the simulated instrument, on loopback."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import pytest

pytest.importorskip("uvicorn", reason="the extra 'daemon' is not installed")

from support.daemon_process import Daemon

StartDaemon = Callable[..., Daemon]


@pytest.fixture(scope="session")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's instrument with 24 × 16 pixels, as a TOML file."""
    text = (resources.files("hueflight.model") / "presets" / "paper.toml").read_text("utf-8")
    text = re.sub(r"(?m)^rows = 192$", "rows = 24", text)
    text = re.sub(r"(?m)^cols = 128$", "cols = 16", text)
    # the same field of view with larger pixels
    text = text.replace("pixel_width_um = 18.4", "pixel_width_um = 147.2")
    text = text.replace("pixel_height_um = 9.2", "pixel_height_um = 73.6")
    path = tmp_path_factory.mktemp("instrument") / "small.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="session")
def start(small_file: Path) -> Iterator[StartDaemon]:
    """Function that starts a daemon: start(folder, port=0, top="", **server)."""
    started: list[Daemon] = []

    def run(
        folder: Path, *, port: int = 0, top: str = "", **server: str | int | list[str]
    ) -> Daemon:
        lines = [
            'name = "bench"', f'instrument = "{small_file}"', f'data = "{folder}/data"',
            'rig = "simulated:fig1?frames=2400&distance=0.4"', "pictures_hz = 30",
            top,
            "[server]", f"port = {port}", "requests_per_s = 500", "burst = 500",
            *(f"{key} = {value!r}" for key, value in server.items()),
        ]  # fmt: skip
        config = folder / "daemon.toml"
        config.write_text("\n".join(lines).replace("'", '"'))
        started.append(Daemon(config, {}))
        return started[-1]

    yield run
    for daemon in started:
        daemon.end()


@pytest.fixture(scope="session")
def daemon(start: StartDaemon, tmp_path_factory: pytest.TempPathFactory) -> Daemon:
    return start(tmp_path_factory.mktemp("daemon"))
