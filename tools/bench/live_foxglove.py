# SPDX-License-Identifier: Apache-2.0
"""Foxglove live while a camera is recorded: pictures received, delay, frames lost.

    python3 tools/dev.py bench live_foxglove --seconds 10
    python3 tools/dev.py bench live_foxglove --rate 480 --occupancy 0     # the paper's rate

A daemon plays drawn frames of the paper's scene at the full rate of the sensor, records them all,
and serves Foxglove. A client of the protocol, written from its text, subscribes to every channel,
to those of the layout in the documentation, or to two, and decodes all messages. The delay is the
time from the arrival of a picture's last photon until the client has decoded its last message. All
of it runs on one machine.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import daemon as camera_at_pace
import numpy as np
from _measure import table

import hueflight as hf

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from support.foxglove_client import FoxgloveClient

PICTURES_HZ = 30
SUBSCRIPTIONS = {
    "everything": (),
    "points, color, depth": ("/points", "/color", "/depth"),  # of docs/foxglove-layout.json
    "depth, color": ("/depth", "/color"),
}
LOG = "/log"
COLUMNS = [
    "subscribed to", "channels", "pictures/s received", "pictures/s made", "MB/s", "median delay",
    "99 %", "frames recorded", "lost",
]  # fmt: skip


def measured(urls: tuple[str, str], wanted: tuple[str, ...], seconds: float) -> list[str]:
    """A row of the table behind its first column."""
    with hf.connect(urls[0]) as camera, FoxgloveClient(urls[1]) as client:
        client.wait_for(lambda: "/points" in client.channels)
        topics = [name for name in wanted or client.channels if name != LOG]
        client.subscribe(topics)
        name = camera.record()
        _receive(client, topics[-1], camera_at_pace.SETTLE_S)
        made = camera.status()["picture"]["number"]
        delays_s, size = _receive(client, topics[-1], seconds)
        made = camera.status()["picture"]["number"] - made
        camera.stop_recording()
        summary = camera.wait_for_recording(name, timeout_s=60)
    median, high = 1e3 * np.quantile(delays_s, [0.5, 0.99])
    return [
        str(len(topics)), f"{len(delays_s) / seconds:.1f}", f"{made / seconds:.1f}",
        f"{size / seconds / 1e6:.0f}", f"{median:.0f} ms", f"{high:.0f} ms",
        f"{summary['recorded_frames']:,} of {summary['exposed']:,}",
        str(sum(summary["lost"].values())),
    ]  # fmt: skip


def _receive(client: FoxgloveClient, last: str, seconds: float) -> tuple[list[float], int]:
    """Delays of the pictures of some seconds, and the bytes of their data."""
    end_s, delays_s, size = time.time() + seconds, [], 0
    while (now_s := time.time()) < end_s:
        topic, time_ns, message = client.next_message()
        size += len(getattr(message, "data", b""))
        if topic == last:
            delays_s.append(now_s - time_ns / 1e9)
    return delays_s, size


def _urls(log: Path) -> list[str]:
    """Addresses of the daemon and of its port for Foxglove, as far as it has told them."""
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    return [line["url"] for line in lines if "url" in line]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rate", type=float, default=18_600.0, help="frames per second")
    parser.add_argument("--occupancy", type=float, default=0.3, help="0: what the scene has")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each row")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hueflight-bench-") as name:
        folder = Path(name)
        log = folder / "daemon.log"
        command = [
            sys.executable, camera_at_pace.__file__, "--serve", name, "--foxglove",
            "--rate", str(arguments.rate), "--occupancy", str(arguments.occupancy),
            "--pictures", str(PICTURES_HZ), "--buffer", "32",
        ]  # fmt: skip
        with camera_at_pace.running(command, log):
            camera_at_pace.until(lambda: len(_urls(log)) == 2, "the daemon listens")
            first, second = (url.rstrip("/") for url in _urls(log))
            camera_at_pace.calibrate(first)
            rows = [
                [label, *measured((first, second), topics, arguments.seconds)]
                for label, topics in SUBSCRIPTIONS.items()
            ]
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print(table(COLUMNS, rows))


if __name__ == "__main__":
    main()
