# SPDX-License-Identifier: Apache-2.0
"""A daemon with the paper's instrument of 24 × 16 pixels, simulated, on loopback."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

from support.daemon_process import Daemon


def small_instrument(folder: Path) -> Path:
    """The instrument as a TOML file: the same field of view with larger pixels."""
    text = (resources.files("hueflight.model") / "presets" / "paper.toml").read_text("utf-8")
    text = re.sub(r"(?m)^rows = 192$", "rows = 24", text)
    text = re.sub(r"(?m)^cols = 128$", "cols = 16", text)
    text = text.replace("pixel_width_um = 18.4", "pixel_width_um = 147.2")
    text = text.replace("pixel_height_um = 9.2", "pixel_height_um = 73.6")
    path = folder / "small.toml"
    path.write_text(text)
    return path


def small_daemon(
    folder: Path,
    instrument: Path,
    *,
    port: int = 0,
    top: str = "",
    **server: str | int | list[str],
) -> Daemon:
    """Start a daemon: `top` are lines of its configuration, `server` entries of that table."""
    lines = [
        'name = "bench"', f'instrument = "{instrument}"', f'data = "{folder}/data"',
        'rig = "simulated:fig1?frames=2400&distance=0.4"', "pictures_hz = 30", top,
        "[server]", f"port = {port}", "requests_per_s = 500", "burst = 500",
        *(f"{key} = {value!r}" for key, value in server.items()),
    ]  # fmt: skip
    config = folder / "daemon.toml"
    config.write_text("\n".join(lines).replace("'", '"'))
    return Daemon(config, {})
