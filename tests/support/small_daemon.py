# SPDX-License-Identifier: Apache-2.0
"""A daemon with the paper's instrument of 24 × 16 pixels, simulated, on loopback."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

from support.daemon_process import Daemon


def small_instrument(folder: Path, *, rows: int = 24, cols: int = 16, **sensor: float) -> Path:
    """The instrument as a TOML file: the same field of view with larger pixels.

    `sensor` are other entries of that table, such as ``frame_rate_hz``.
    """
    text = (resources.files("hueflight.model") / "presets" / "paper.toml").read_text("utf-8")
    entries = {
        "rows": rows, "cols": cols, "pixel_width_um": round(18.4 * 128 / cols, 6),
        "pixel_height_um": round(9.2 * 192 / rows, 6),
    } | sensor  # fmt: skip
    for name, value in entries.items():
        text, number = re.subn(rf"(?m)^{name} = \S+", f"{name} = {value}", text)
        assert number == 1, name
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
