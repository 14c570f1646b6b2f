"""The daemon at the pace of a camera: frames lost, memory, CPU by stage, delay to the browser.

    python tools/bench/daemon.py --rate 18600 --seconds 60 --record --plot run.svg

A camera model with simulated photons of the paper's scene plays frames in real time within the
daemon's process; its own share of CPU is measured and stated. Headless Chromium shows the page.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
from _measure import table

from hueflight.instrument import Instrument

PATIENCE_S = 180.0
BROWSER = [
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--remote-debugging-port=0",
]  # fmt: skip


def played(name: str, rate_hz: float) -> Instrument:
    """An instrument at another frame rate."""
    paper = Instrument.load(name)
    exposure_ms = min(paper.sensor.exposure_ms or 2.0, 0.9e3 / rate_hz)
    sensor = msgspec.structs.replace(paper.sensor, frame_rate_hz=rate_hz, exposure_ms=exposure_ms)
    return paper.replace(sensor=sensor)


# -- the daemon's process ----------------------------------------------------------------------


def serve(
    folder: Path, name: str, rate_hz: float, pictures_hz: float, drawn: int, change_sigma: float
) -> None:
    """Run a daemon whose camera plays frames that were drawn beforehand."""
    from hueflight.daemon.config import DaemonConfig, ServerConfig
    from hueflight.daemon.logs import configure
    from hueflight.daemon.server import serve as run
    from hueflight.devices import Camera, CameraModel, FrameBank, Rig
    from hueflight.devices.frame_bank import simulated_packets
    from hueflight.devices.lights import CaptureKind
    from hueflight.devices.model_ports import ModelStream, ModelTransport

    text = Instrument.load(name).to_json()
    banks = {
        kind: FrameBank(simulated_packets(kind, text, "fig1", 0.4, drawn, 1))
        for kind in ("scene", "reference")
    }
    instrument = played(name, rate_hz)
    model = CameraModel(instrument.sensor, banks["scene"])
    emulated = 0.0

    class TimedStream(ModelStream):
        def read(self, timeout_s: float, /) -> bytes:
            nonlocal emulated
            before = time.thread_time()
            data = super().read(timeout_s)
            emulated += time.thread_time() - before
            return data

    class Targets:
        name = "benchmark"

        def prepare(self, kind: CaptureKind, frames: int, /) -> None:
            model.bank = banks[kind]

        def keep_alive(self) -> None:
            """Need nothing."""

        def close(self) -> None:
            """Need nothing."""

    def connect() -> Rig:
        camera = Camera(
            ModelTransport(model.handle), lambda size: TimedStream(model, size), simulated=True
        )
        return Rig(camera, Targets())

    configure(as_json=True)
    config = DaemonConfig(
        data=str(folder / "data"), pictures_hz=pictures_hz, change_sigma=change_sigma,
        server=ServerConfig(port=0, requests_per_s=1000, burst=1000),
    )  # fmt: skip
    try:
        run(config, connect, instrument)
    finally:
        (folder / "emulated").write_text(str(emulated))


# -- who looks at it ---------------------------------------------------------------------------


@contextlib.contextmanager
def running(command: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process in a group of its own, ended for certain."""
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
    try:
        yield process
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(20)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(20)


def until(found: Callable[[], Any], what: str) -> Any:
    """Wait for something that must come."""
    print(f"waiting until {what}", file=sys.stderr)
    deadline = time.monotonic() + PATIENCE_S
    while not (value := found()):
        if time.monotonic() > deadline:
            raise SystemExit(f"waited {PATIENCE_S:g} s until {what}")
        time.sleep(0.1)
    return value


def ask(url: str, body: object = None) -> bytes:
    """Answer to a request, a POST if there is a body."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return answer.read()


def cpu_s(url: str) -> dict[str, float]:
    """CPU seconds of the daemon's threads."""
    found = re.findall(
        r'^hueflight_thread_cpu_seconds_total\{thread="([^"]+)"\} (\S+)',
        ask(url + "/metrics").decode(), re.M,
    )  # fmt: skip
    return {name: float(value) for name, value in found}


def resident_mb(process: int) -> float:
    """Memory of a process."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(arguments: argparse.Namespace, folder: Path) -> None:
    """Run the daemon and a browser, and print what came of it."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("this benchmark needs the Debian package chromium")
    log = folder / "daemon.log"
    me = [
        sys.executable, __file__, "--serve", str(folder), "--instrument", arguments.instrument,
        "--rate", str(arguments.rate), "--pictures", str(arguments.pictures),
        "--drawn", str(arguments.drawn), "--change-sigma", str(arguments.change_sigma),
    ]  # fmt: skip
    with running(me, log) as daemon:
        line = until(lambda: _first_line(log, daemon), "the daemon listens")
        url = json.loads(line)["url"].rstrip("/")
        status: Callable[[], Any] = lambda: json.loads(ask(url + "/api/status"))  # noqa: E731
        until(lambda: status()["totals"]["delivered"] > 100, "frames come")
        ask(url + "/api/calibration", {"distance": 0.4, "frames": 2000, "bands": False,
                                       "dark": False})  # fmt: skip
        until(lambda: status()["calibration"]["step"] in ("done", "failed"), "it is calibrated")
        calibration = status()["calibration"]
        if calibration["step"] == "failed":
            raise SystemExit(f"no calibration: {calibration['message']}")
        page = [chromium, *BROWSER, f"--user-data-dir={folder / 'profile'}", url]
        with running(page, folder / "browser.log"):
            until(lambda: status()["latency_s"], "the browser shows pictures")
            if arguments.record:
                ask(url + "/api/recordings", {"name": "bench"})
                until(lambda: status()["recording"]["frames"], "it records")
            before, busy = status(), cpu_s(url)
            began = time.monotonic()
            samples: list[Any] = []
            while time.monotonic() - began < arguments.seconds:
                time.sleep(1)
                samples.append((time.monotonic() - began, resident_mb(daemon.pid), status()))
            elapsed, after = time.monotonic() - began, status()
            busy = {name: used - busy.get(name, 0.0) for name, used in cpu_s(url).items()}
            if arguments.record:
                ask(url + "/api/recordings/stop", {})
                until(lambda: status()["recording"]["last"], "the recording has ended")
    show(arguments, elapsed, before, after, busy, samples)
    emulated = float((folder / "emulated").read_text())
    print(f"The emulated camera took {emulated:.1f} s of the acquisition thread's CPU in all.")
    if arguments.plot:
        plot(arguments.plot, samples)


def _first_line(log: Path, process: subprocess.Popen[bytes]) -> str:
    if process.poll() is not None:
        raise SystemExit(f"the daemon has ended:\n{log.read_text()}")
    return next((line for line in log.read_text().splitlines() if '"url"' in line), "")


def show(
    arguments: argparse.Namespace, elapsed: float, before: Any, after: Any,
    busy: dict[str, float], samples: list[Any],
) -> None:  # fmt: skip
    """Print the tables."""

    def more(group: str, name: str) -> int:
        return after[group][name] - before[group][name]

    lost = {place: more("lost", place) for place in after["lost"]}
    delivered = more("totals", "delivered")
    sensor = Instrument.load(arguments.instrument).sensor
    pixels = sensor.rows * sensor.cols
    occupancy = more("totals", "photons") / max(1, delivered) / pixels
    memory = [megabytes for _, megabytes, _ in samples]
    steady = memory[len(memory) // 5 :]
    print(f"## {elapsed:.0f} s at {arguments.rate:g} frames per second\n")
    print(table(["what", "value"], [
        ["frames delivered per second", f"{delivered / elapsed:,.0f}"],
        ["occupancy", f"{occupancy:.3f}"],
        ["MB per second", f"{more('totals', 'bytes') / elapsed / 1e6:.1f}"],
        ["frames lost", ", ".join(f"{place} {n}" for place, n in lost.items())],
        ["pictures per second", f"{more('picture', 'number') / elapsed:.1f}"],
        ["memory after a fifth, at the end, most (MB)",
         f"{steady[0]:.0f}, {steady[-1]:.0f}, {max(steady):.0f}"],
        ["load of the machine", f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"],
    ]))  # fmt: skip
    delays = after["latency_s"]
    print(table(["last photon to shown", "ms"],
                [[name, f"{1e3 * delays[name]:.0f}"] for name in delays]))  # fmt: skip
    shares = sorted(busy.items(), key=lambda item: -item[1])
    rows = [[name, f"{used / elapsed:.3f}"] for name, used in shares if used > 1e-3 * elapsed]
    print(table(["thread", "share of one core"], rows))


def plot(path: Path, samples: list[Any]) -> None:
    """Memory, frames lost and delay over time."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "hueflight"
    import matplotlib.pyplot as plt

    seconds = [at for at, _, _ in samples]
    figure, axes = plt.subplots(3, sharex=True, figsize=(7, 5), layout="constrained")
    for axis, label, values in (
        (axes[0], "memory (MB)", [megabytes for _, megabytes, _ in samples]),
        (axes[1], "frames lost", [sum(found["lost"].values()) for *_, found in samples]),
        (axes[2], "delay, median (ms)", [1e3 * found["latency_s"]["p50"] for *_, found in samples]),
    ):
        axis.plot(seconds, values, color="tab:blue")
        axis.set(ylabel=label, ylim=(0, 1.3 * max(values) or 1))
    axes[2].set(xlabel="time (s)", xlim=(0, seconds[-1]))
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    # a time-out that ends this must not leave the daemon and the browser behind
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended from outside"))
    parser = argparse.ArgumentParser(description="The daemon at the pace of a camera.")
    parser.add_argument("--rate", type=float, default=480.0, help="frames per second")
    parser.add_argument("--instrument", default="paper", help="preset or TOML file")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--pictures", type=float, default=0.0, help="per second; 0: what suits")
    parser.add_argument("--change-sigma", type=float, default=4.0, help="0: fit every pixel")
    parser.add_argument("--drawn", type=int, default=240, help="frames that are played in turn")
    parser.add_argument("--record", action="store_true", help="record meanwhile")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve(
            arguments.serve, arguments.instrument, arguments.rate, arguments.pictures,
            arguments.drawn, arguments.change_sigma,
        )  # fmt: skip
        return
    with tempfile.TemporaryDirectory(prefix="hueflight-bench-") as folder:
        measure(arguments, Path(folder))


if __name__ == "__main__":
    main()
