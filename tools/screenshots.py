# SPDX-License-Identifier: Apache-2.0
"""Take the pictures of the live page that the documentation shows.

    python tools/screenshots.py

A daemon with the simulated instrument, and headless Chromium driven by Playwright.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

import hueflight as hf
from hueflight.recording.writer import RecordingWriter
from hueflight.simulator import scene, simulate_capture, simulate_packets

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
LONGEST_S = 400  #: then all is given up
PATIENCE_S = 90.0
CONFIG = """
name = "bench-1"
data = "{data}"
simulate = true
[server]
port = 0
"""
#: of a second daemon, shown beside the first one
OTHER = """
name = "bench-2"
data = "{data}"
rig = "simulated:colorchecker"
[server]
port = 0
[[cameras]]
address = "{url}"
"""
FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"]
#: whether all tiles of the page of cameras show new pictures
NEW = "() => [...document.querySelectorAll('.tile .stale')].every(each => !each.textContent)"
#: file, key of the view, colour scheme, width and height, keys; "play" plays a recording
SHOTS = (
    ("daemon-depth", "1", "dark", (1366, 900), ("Shift+ArrowRight", "Shift+ArrowUp")),
    ("daemon-bands", "3", "light", (1366, 900), ("Shift+ArrowDown", "Shift+ArrowRight")),
    ("daemon-points", "4", "dark", (1366, 900), ()),
    ("daemon-phone", "2", "light", (390, 844), ("ArrowRight",)),
    ("daemon-player", "1", "light", (1366, 900), ("l", "play", "End", "ArrowRight")),
)


@contextlib.contextmanager
def daemon(folder: Path, text: str = CONFIG, **values: str) -> Iterator[str]:
    """A running daemon's address."""
    config = folder / "daemon.toml"
    config.write_text(text.format(data=folder / "data", **values))
    command = "from hueflight.cli import main; main()"
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", command, "serve", str(config), "--json-logs"],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log,
        )  # fmt: skip
    try:
        deadline = time.monotonic() + PATIENCE_S
        while '"url"' not in (text := (folder / "log").read_text()):
            if process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"no daemon:\n{text}")
            time.sleep(0.1)
        line = next(line for line in text.splitlines() if '"url"' in line)
        yield json.loads(line)["url"].rstrip("/")
    finally:
        process.terminate()
        process.wait(30)


def calibrate(folder: Path) -> None:
    """Put a calibration into the folder of a daemon's data."""
    instrument = hf.Instrument.load("paper")
    reference = simulate_capture("reference", instrument, frames=40_000, seed=5)
    kept = folder / "data" / "calibrations" / "20260101T000000Z"
    kept.mkdir(parents=True)
    hf.calibrate(reference, instrument, distance=0.4).save(kept / "calibration.zarr")


def record(folder: Path) -> None:
    """Put a recording of twelve seconds into the folder, to be played."""
    instrument = hf.Instrument.load("paper")
    path = folder / "data" / "recordings" / "vase.mcap"
    path.parent.mkdir(parents=True)
    notes = {"capture": "scene", "simulated": True}
    with RecordingWriter(path, instrument, metadata=notes) as writer:
        looked_at = scene("fig1", instrument)
        for packet in simulate_packets("scene", instrument, frames=6000, scene=looked_at, seed=6):
            writer.write(packet)


def take(browser: Browser, url: str, shot: tuple[Any, ...]) -> None:
    """Open the page, choose what to see, and keep it as a picture."""
    name, key, scheme, (width, height), keys = shot
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page: Page = context.new_page()
    page.set_default_timeout(PATIENCE_S * 1e3)
    page.goto(url)
    page.wait_for_function("() => document.querySelector('#state').textContent === 'live'")
    page.wait_for_selector("#hint", state="hidden")
    page.focus("#view")
    page.keyboard.press(key)
    for pressed in keys:
        if pressed == "play":
            page.click("[data-name=vase] button:text('Play')")
            page.wait_for_selector("#player", state="visible")
            page.select_option("#span", "10")
            page.focus("#view")
        else:
            page.keyboard.press(pressed)
    if keys:
        page.wait_for_function(
            "() => document.querySelector('#pixel-note').textContent.includes('photons in')"
        )
    page.wait_for_timeout(15_000)  # photons add up
    page.screenshot(path=IMAGES / f"{name}.png", timeout=PATIENCE_S * 1e3)
    context.close()


def main() -> None:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("this needs the Debian package chromium")
    signal.signal(signal.SIGALRM, lambda *_: sys.exit(f"still not done after {LONGEST_S} s"))
    signal.alarm(LONGEST_S)
    wanted = sys.argv[1:]
    with tempfile.TemporaryDirectory(prefix="hueflight-shots-") as folder:
        calibrate(Path(folder))
        record(Path(folder))
        shoot(Path(folder), wanted, chromium)


def shoot(folder: Path, wanted: list[str], chromium: str) -> None:
    """Take the pictures that are wanted of a daemon with its data in a folder."""
    with daemon(folder) as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=FLAGS, timeout=PATIENCE_S * 1e3
        )
        for shot in SHOTS:
            if not wanted or shot[0] in wanted:
                take(browser, url, shot)
        if not wanted or "daemon-cameras" in wanted:
            take_cameras(browser, url, folder)
        browser.close()


def take_cameras(browser: Browser, url: str, folder: Path) -> None:
    """Keep a picture of the page of two cameras."""
    other = folder / "other"
    shutil.copytree(folder / "data" / "calibrations", other / "data" / "calibrations")
    with daemon(other, OTHER, url=url) as second:
        context = browser.new_context(viewport={"width": 1366, "height": 470}, color_scheme="dark")
        page = context.new_page()
        page.set_default_timeout(PATIENCE_S * 1e3)
        page.goto(f"{second}/cameras.html")
        page.wait_for_function(
            "() => [...document.querySelectorAll('.tile .pill')].filter("
            "each => each.textContent === 'live').length === 2"
        )
        page.wait_for_timeout(15_000)  # photons add up
        deadline = time.monotonic() + PATIENCE_S
        while True:
            page.wait_for_function(NEW)
            page.screenshot(path=IMAGES / "daemon-cameras.png", timeout=PATIENCE_S * 1e3)
            if page.evaluate(NEW):
                break  # it shows no older ones, since there were new ones before and after
            if time.monotonic() > deadline:
                raise SystemExit("the machine is too busy for pictures of two cameras")
        context.close()


if __name__ == "__main__":
    main()
