# SPDX-License-Identifier: Apache-2.0
"""The daemon at the pace of a camera: frames lost, memory, CPU by stage, delay to the browser.

    python tools/bench/daemon.py                                        # the delay
    python tools/bench/daemon.py --rate 18600 --occupancy 0.3 --seconds 600 --record --search \
        --docs run                                                      # the long run
    python tools/bench/daemon.py --nightly                              # 90 minutes at full rate
    python tools/bench/daemon.py --nightly --rate 4800 --seconds 600    # ten minutes, slower
    python tools/bench/daemon.py --nightly --seconds 604800             # a week
    python tools/bench/daemon.py --link "USB 2" --rate 18600 --pictures 30 --occupancy 0.3 \
        --seconds 60                                                    # live from sums
    python tools/bench/daemon.py --sends codes --rate 18600 --pictures 30 --occupancy 0.3 \
        --seconds 60                                                    # from codes, beside that

The nightly run records throughout, erases old segments, and fails if a frame is lost anywhere but
in the camera's buffer, or if memory leaves a band of one per cent either way after the first fifth.
A camera model with simulated photons of the paper's scene plays frames in real time, in a process
of its own; its share of CPU is measured and stated. Headless Chromium shows the page.
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
import numpy as np
from _camera_process import CameraProcess, ProcessStream
from _daemon_report import into_documentation, plot, shortcomings, tables, thinned

from hueflight.ingest import accumulate
from hueflight.model.instrument import Instrument
from hueflight.numerical_threads import ONE_THREAD
from hueflight.recording import open_recording
from hueflight.recording.layout import segment_files
from hueflight_protocol.links import LINKS

RECORDING = "data/recordings/bench.mcap"  #: in the daemon's folder
PATIENCE_S = 180.0
CHOICE_S = 10.0  #: in which the daemon has chosen codes or sums
SETTLE_S = 8.0  #: before a measurement: the browser's first pictures are slow
CALIBRATIONS = 20  #: that are tried
TRIAL_S = 20.0
SAMPLES_KEPT = 7200  #: of one a second; beyond, every other one is dropped
NIGHT_S = 5400.0
SLOWER = 0.85  #: of the rate, when frames were lost
LEAST = 0.1  #: of the rate asked for: no slower trials
BISECTIONS = 9  #: on the way to an exposure that gives the occupancy asked for
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


def brightened(instrument: Instrument, occupancy: float) -> Instrument:
    """An instrument whose exposures are as long as the scene needs for a mean occupancy."""
    from hueflight.emulation.frame_bank import simulated_packets

    def exposed(exposure_ms: float) -> Instrument:
        sensor = msgspec.structs.replace(instrument.sensor, exposure_ms=exposure_ms)
        return instrument.replace(sensor=sensor)

    shortest, longest = 0.01, 100.0
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(shortest * longest))
        text = exposed(middle).to_json()
        packets = simulated_packets("scene", text, "fig1", 0.4, 2, 1)
        counts, _ = accumulate(b"".join(packets), instrument)
        if counts[..., 1:].sum() < occupancy * counts.sum():
            shortest = middle
        else:
            longest = middle
    return exposed(shortest)


def serve(arguments: argparse.Namespace) -> None:
    """Run a daemon whose camera plays frames that were drawn beforehand."""
    from hueflight.daemon.config import DaemonConfig, ServerConfig
    from hueflight.daemon.http.server import serve as run
    from hueflight.daemon.logs import configure
    from hueflight.devices import Camera, Rig
    from hueflight.devices.illumination import CaptureKind
    from hueflight.emulation.simulated_transport import SimulatedTransport

    folder: Path = arguments.serve
    drawing = Instrument.load(arguments.instrument)
    if arguments.occupancy:
        drawing = brightened(drawing, arguments.occupancy)
    instrument = played(arguments.instrument, arguments.rate)
    buffer_bytes = round(arguments.buffer * (1 << 20))
    camera = CameraProcess(
        drawing, instrument, arguments.drawn, buffer_bytes, folder / "emulated",
        LINKS.get(arguments.link, float("inf")),
    )  # fmt: skip

    class Targets:
        name = "benchmark"

        def prepare(self, kind: CaptureKind, frames: int, /) -> None:
            camera.show(kind)

        def keep_alive(self) -> None:
            """Need nothing."""

        def close(self) -> None:
            """Need nothing."""

    def connect() -> Rig:
        transport = SimulatedTransport(camera.handle)
        driver = Camera(
            transport,
            lambda size: ProcessStream(camera, size),
            simulated=True,
            link=arguments.link,
        )
        return Rig(driver, Targets())

    configure(as_json=True)
    config = DaemonConfig(
        data=str(folder / "data"), pictures_hz=arguments.pictures,
        change_sigma=arguments.change_sigma, foxglove=arguments.foxglove, sends=arguments.sends,
        server=ServerConfig(port=0, foxglove_port=0, requests_per_s=1000, burst=1000),
    )  # fmt: skip
    run(config, connect, instrument)


# -- who looks at it ---------------------------------------------------------------------------


@contextlib.contextmanager
def running(command: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process in a group of its own, ended for certain."""
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
            env=os.environ | ONE_THREAD,  # as the command `hueflight serve` does
        )  # fmt: skip
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


def process_cpu_s(process: int) -> float:
    """CPU seconds of a process, ended threads included."""
    used = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(used[11]) + int(used[12])) / os.sysconf("SC_CLK_TCK")


def session_cpu_s(session: int) -> float:
    """CPU seconds of the processes of a session."""
    total = 0.0
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ProcessLookupError):  # it has just ended
            if os.getsid(int(entry.name)) == session:
                total += process_cpu_s(int(entry.name))
    return total


class Stages:
    """CPU seconds by stage of a daemon and of a browser that looks at it."""

    def __init__(self, url: str, folder: Path, daemon: int, browser: int) -> None:
        self._url, self._folder, self._daemon, self._browser = url, folder, daemon, browser
        self._recorder = self._recorder_before = 0.0

    def __call__(self) -> dict[str, float]:
        """As they stand."""
        text = ask(self._url + "/metrics").decode()
        pattern = r'^hueflight_thread_cpu_seconds_total\{thread="([^"]+)"\} (\S+)'
        found = {name: float(value) for name, value in re.findall(pattern, text, re.M)}
        # each recording has a thread of its own, whose time is gone when it ends
        recorder = found.get("recorder", 0.0)
        self._recorder += max(0.0, recorder - self._recorder_before)
        self._recorder_before = recorder
        emulated = float((self._folder / "emulated").read_text())
        named = found["acquisition"] + self._recorder + found["MainThread"]
        return {
            "emulated camera": emulated,
            "checking and counting": found["acquisition"],
            "recording": self._recorder,
            # threads that help with a picture live as long as it takes: they are what is left
            "pictures": process_cpu_s(self._daemon) - named,
            "serving": found["MainThread"],
            "browser": session_cpu_s(self._browser),
        }


def resident_mb(process: int) -> float:
    """Memory of a process."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(arguments: argparse.Namespace, rate_hz: float, seconds: float) -> dict[str, Any]:
    """Run the daemon and a browser; what came of it."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("this benchmark needs the Debian package chromium")
    with tempfile.TemporaryDirectory(prefix="hueflight-bench-", dir=arguments.folder) as name:
        folder = Path(name)
        me = [
            sys.executable, __file__, "--serve", name, "--instrument", arguments.instrument,
            "--rate", str(rate_hz), "--pictures", str(arguments.pictures),
            "--drawn", str(arguments.drawn), "--change-sigma", str(arguments.change_sigma),
            "--occupancy", str(arguments.occupancy), "--buffer", str(arguments.buffer),
            "--link", arguments.link, "--sends", arguments.sends,
        ]  # fmt: skip
        with running(me, folder / "daemon.log") as daemon:
            line = until(lambda: _first_line(folder / "daemon.log", daemon), "the daemon listens")
            url = json.loads(line)["url"].rstrip("/")
            calibrate(url)
            page = [chromium, *BROWSER, f"--user-data-dir={folder / 'profile'}", url]
            with running(page, folder / "browser.log") as browser:
                until(lambda: status_of(url)["latency_s"], "the browser shows pictures")
                if arguments.link or arguments.sends == "sums":
                    time.sleep(CHOICE_S)
                return _watch(arguments, seconds, url, folder, (daemon.pid, browser.pid)) | {
                    "rate_hz": rate_hz
                }


def status_of(url: str) -> Any:
    """How the daemon says things stand."""
    return json.loads(ask(url + "/api/status"))


def calibrate(url: str) -> None:
    """Calibrate with the reference; its first frames may be lost while all warms up."""
    until(lambda: status_of(url)["totals"]["delivered"] > 100, "frames come")
    wish = {"distance": 0.4, "frames": 4000, "bands": False, "dark": False}
    message = ""
    for _ in range(CALIBRATIONS):
        ask(url + "/api/calibration", wish)
        until(
            lambda: status_of(url)["calibration"]["step"] in ("done", "failed"), "it is calibrated"
        )
        calibration = status_of(url)["calibration"]
        if calibration["step"] == "done":
            return
        message = calibration["message"]
    raise SystemExit(f"no calibration: {message}")


def _watch(
    arguments: argparse.Namespace,
    seconds: float,
    url: str,
    folder: Path,
    processes: tuple[int, int],
) -> dict[str, Any]:
    """Sample a running daemon once a second."""
    daemon, _ = processes
    cpu_s = Stages(url, folder, *processes)
    record_s = min(arguments.record, seconds)
    if record_s:
        ask(url + "/api/recordings", {"name": Path(RECORDING).stem, "seconds": record_s + SETTLE_S})
        until(lambda: status_of(url)["recording"]["frames"], "it records")
    time.sleep(SETTLE_S)
    before, busy = status_of(url), cpu_s()
    began, samples = time.monotonic(), []

    def since(group: dict[str, Any], start: dict[str, Any]) -> dict[str, Any]:
        return {name: value - start[name] for name, value in group.items()}

    while time.monotonic() - began < seconds:
        time.sleep(1)
        erase_oldest(folder / RECORDING, arguments.keep)
        now = status_of(url)
        samples.append(
            {
                "time_s": round(time.monotonic() - began, 2),
                "memory_mb": round(resident_mb(daemon), 1),
                "lost": since(now["lost"], before["lost"]),
                "latency_s": now["latency_s"],
                "cpu_s": since(cpu_s(), busy),
            }
        )
        if len(samples) > SAMPLES_KEPT:
            samples = samples[::-2][::-1]
    elapsed, after, cpu = time.monotonic() - began, status_of(url), since(cpu_s(), busy)
    totals = since(after["totals"], before["totals"])
    sensor = Instrument.load(arguments.instrument).sensor
    return {
        "elapsed_s": elapsed,
        "shape": [sensor.rows, sensor.cols],
        "delivered": totals["delivered"],
        "bytes": totals["bytes"],
        "occupancy": totals["photons"] / max(1, totals["delivered"]) / sensor.rows / sensor.cols,
        "lost": since(after["lost"], before["lost"]),
        "record_s": record_s,
        "recording": read_back(url, folder / RECORDING) if record_s else None,
        "pictures": after["picture"]["number"] - before["picture"]["number"],
        "skipped": after["picture"]["skipped"] - before["picture"]["skipped"],
        "method": after["picture"]["method"],
        "stream": after["stream"],
        "latency_s": after["latency_s"],
        "cpu_s": cpu,
        "load": os.getloadavg()[0],
        "cores": os.cpu_count(),
        "samples": thinned(samples),
    }


def erase_oldest(recording: Path, keep_gb: float) -> None:
    """Make room: erase finished segments, of those that are more than so much."""
    left = keep_gb * 1e9 if keep_gb else float("inf")
    for segment in reversed(segment_files(recording)[0]):
        left -= segment.stat().st_size
        if left < 0:
            segment.unlink()


def read_back(url: str, recording: Path) -> dict[str, int]:
    """What the recording's run delivered and recorded; frames of segments that are still there."""
    run = until(lambda: status_of(url)["recording"]["last"], "the recording is whole")
    segments, frames, intact = segment_files(recording)[0], 0, 0
    # the first file opens all of them; if it was erased, each opens itself
    for path in [recording] if recording in segments else segments:
        with open_recording(path) as part:
            frames += part.frames
            intact += part.accumulate()[1].frames
    return {
        "delivered": run["delivered"], "recorded": run["recorded_frames"],
        "segments": len(segments), "in_segments": frames, "intact": intact,
    }  # fmt: skip


def highest_rate(arguments: argparse.Namespace) -> tuple[float, list[tuple[float, int]]]:
    """The highest rate at which a short run loses no frame, and what was tried."""
    tried: list[tuple[float, int]] = []
    rate_hz = arguments.rate
    while rate_hz > LEAST * arguments.rate:
        lost = sum(measure(arguments, rate_hz, TRIAL_S)["lost"].values())
        tried.append((rate_hz, lost))
        print(f"{rate_hz:,.0f} frames per second: {lost:,} lost", file=sys.stderr)
        if not lost:
            return rate_hz, tried
        rate_hz *= SLOWER
    raise SystemExit(f"frames were lost at every rate: {tried}")


def _first_line(log: Path, process: subprocess.Popen[bytes]) -> str:
    if process.poll() is not None:
        raise SystemExit(f"the daemon has ended:\n{log.read_text()}")
    return next((line for line in log.read_text().splitlines() if '"url"' in line), "")


def main() -> None:
    # a time-out that ends this must not leave the daemon and the browser behind
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended from outside"))
    parser = argparse.ArgumentParser(description="The daemon at the pace of a camera.")
    parser.add_argument("--rate", type=float, default=480.0, help="frames per second")
    parser.add_argument("--search", action="store_true", help="slower, until no frame is lost")
    parser.add_argument("--instrument", default="paper", help="preset or TOML file")
    parser.add_argument(
        "--nightly", action="store_true",
        help="at 18,600 frames per second and an occupancy of 0.3, unless said otherwise, with "
        "90 minutes of recording, of which 20 GB are kept; fails if frames are lost or memory "
        "changes",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--pictures", type=float, default=0.0, help="per second; 0: what suits")
    parser.add_argument("--occupancy", type=float, default=0.0, help="0: what the scene has")
    parser.add_argument(
        "--buffer", type=float, default=8.0, metavar="MIB",
        help="the emulated camera keeps, as transfers under way on a bus do; 8 are what Linux "
        "grants unless told otherwise",
    )  # fmt: skip
    parser.add_argument(
        "--link", choices=("", *LINKS), default="", help="of the emulated camera; empty: no limit"
    )
    parser.add_argument("--sends", choices=("codes", "sums", "auto"), default="auto")
    parser.add_argument("--change-sigma", type=float, default=4.0, help="0: fit every pixel")
    parser.add_argument("--drawn", type=int, default=240, help="frames that are played in turn")
    parser.add_argument(
        "--record", type=float, nargs="?", const=60.0, default=0.0, metavar="SECONDS",
        help="record at the beginning, 60 s unless said otherwise",
    )  # fmt: skip
    parser.add_argument(
        "--keep", type=float, default=0.0, metavar="GB",
        help="erase the oldest finished segments of the recording beyond this; 0: keep all",
    )  # fmt: skip
    parser.add_argument("--folder", type=Path, help="where the recording goes meanwhile")
    parser.add_argument("--plot", type=Path, help="file to draw the run in")
    parser.add_argument(
        "--docs", choices=("run", "delay", "night"), help="write the plot and the tables into docs/"
    )
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--foxglove", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.nightly:
        parser.set_defaults(
            rate=18_600.0, occupancy=0.3, seconds=NIGHT_S, record=float("inf"), keep=20.0,
            buffer=32.0,
        )  # fmt: skip
        arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments)
        return
    rate_hz, trials = highest_rate(arguments) if arguments.search else (arguments.rate, [])
    run = measure(arguments, rate_hz, arguments.seconds)
    run |= {"trials": trials, "trial_s": TRIAL_S, "arguments": " ".join(sys.argv[1:])}
    print(tables(run))
    if arguments.plot:
        plot(arguments.plot, run)
    if arguments.docs:
        into_documentation(arguments.docs, run)
    if arguments.nightly and (wrong := shortcomings(run)):
        raise SystemExit("; ".join(wrong))


if __name__ == "__main__":
    main()
