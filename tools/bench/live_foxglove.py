# SPDX-License-Identifier: Apache-2.0
"""Foxglove live while a camera is recorded: pictures received, delay, frames lost.

    python3 tools/dev.py bench live_foxglove --seconds 20

A daemon plays the simulated instrument, records, and serves Foxglove; a client of the protocol,
written from its text, subscribes to every channel, or to two. The delay is the time from the
arrival of a picture's last photon until the client has its last message.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _measure import table

import hueflight as hf

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from support.daemon_process import Daemon
from support.foxglove_client import FoxgloveClient

CONFIG = """
name = "bench"
instrument = "paper"
data = "{folder}/data"
rig = "simulated:fig1?frames=2400&distance=0.4"
pictures_hz = 30
foxglove = true
[server]
port = 0
foxglove_port = 0
requests_per_s = 500
burst = 500
"""


def measured(daemon: Daemon, wanted: tuple[str, ...], seconds: float) -> list[str]:
    """A row of the table: pictures per second, quantiles of the delay, bytes per second, losses."""
    with hf.connect(daemon.url) as camera, FoxgloveClient(daemon.foxglove_url) as client:
        client.wait_for(lambda: "/points" in client.channels)
        topics = [name for name in client.channels if name in wanted or not wanted]
        client.subscribe([name for name in topics if name != "/log"])
        last = [name for name in topics if name != "/log"][-1]
        name = camera.record()
        made = camera.status()["picture"]["number"]
        begun, delays = time.time(), []
        while (now := time.time()) < begun + seconds:
            topic, time_ns, _ = client.next_message()
            if topic == last:
                delays.append(now - time_ns / 1e9)
        made = camera.status()["picture"]["number"] - made
        camera.stop_recording()
        summary = camera.wait_for_recording(name, timeout_s=60)
    low, high = 1e3 * np.quantile(delays, [0.5, 0.99])
    lost = sum(summary["lost"].values())
    return [
        str(len(topics)), f"{len(delays) / seconds:.1f}", f"{made / seconds:.1f}",
        f"{low:.0f} ms", f"{high:.0f} ms", f"{lost} of {summary['exposed']}",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = folder / "daemon.toml"
        config.write_text(CONFIG.format(folder=folder))
        daemon = Daemon(config, {})
        try:
            with hf.connect(daemon.url) as camera:
                camera.start()
                camera.calibrate(distance=0.4, frames=2000, bands=False, timeout_s=300)
                camera.start()
            rows = [
                ["all", *measured(daemon, (), seconds)],
                ["depth, color", *measured(daemon, ("/depth", "/color"), seconds)],
            ]
        finally:
            daemon.end()
    head = ["subscribed to", "channels", "pictures/s received", "pictures/s made", "median delay",
            "99 %", "frames lost"]  # fmt: skip
    print(table(head, rows))


if __name__ == "__main__":
    main()
