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
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
LONGEST_S = 400  #: then all is given up
PATIENCE_S = 90.0
CONFIG = """
data = "{data}"
simulate = true
picture_frames = 2400
[server]
port = 0
"""
FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"]
#: file, key of the view, colour scheme, width and height, keys that choose a pixel
SHOTS = (
    ("daemon-depth", "1", "dark", (1366, 900), ("ArrowRight", "Shift+ArrowUp")),
    ("daemon-bands", "3", "light", (1366, 900), ("Shift+ArrowDown", "Shift+ArrowRight")),
    ("daemon-phone", "2", "light", (390, 844), ("ArrowRight",)),
)


@contextlib.contextmanager
def daemon(folder: Path) -> Iterator[str]:
    """A running daemon's address."""
    config = folder / "daemon.toml"
    config.write_text(CONFIG.format(data=folder / "data"))
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


def ask(url: str, body: object = None) -> Any:
    """Answer to a request, a POST if there is a body."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.loads(answer.read())


def calibrate(url: str) -> None:
    """Have the daemon calibrate, and wait until pictures are of enough frames."""
    ask(url + "/api/calibration", {"distance": 0.4, "frames": 4000, "bands": False, "dark": False})
    deadline = time.monotonic() + PATIENCE_S
    while ask(url + "/api/status")["calibration"]["step"] not in ("done", "failed"):
        if time.monotonic() > deadline:
            raise SystemExit("the calibration took too long")
        time.sleep(0.5)
    found = ask(url + "/api/status")["calibration"]
    if found["step"] == "failed":
        raise SystemExit(f"no calibration: {found['message']}")


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
        page.keyboard.press(pressed)
    page.wait_for_function(
        "() => document.querySelector('#pixel-note').textContent.includes('photons in')"
    )
    page.wait_for_timeout(7000)  # until the window of frames is full and the figures are steady
    page.screenshot(path=IMAGES / f"{name}.png", timeout=PATIENCE_S * 1e3)
    context.close()


def main() -> None:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("this needs the Debian package chromium")
    signal.signal(signal.SIGALRM, lambda *_: sys.exit(f"still not done after {LONGEST_S} s"))
    signal.alarm(LONGEST_S)
    wanted = sys.argv[1:]
    with (
        tempfile.TemporaryDirectory(prefix="hueflight-shots-") as folder,
        daemon(Path(folder)) as url,
        sync_playwright() as playwright,
    ):
        calibrate(url)
        browser = playwright.chromium.launch(
            executable_path=chromium, args=FLAGS, timeout=PATIENCE_S * 1e3
        )
        for shot in SHOTS:
            if not wanted or shot[0] in wanted:
                take(browser, url, shot)
        browser.close()


if __name__ == "__main__":
    main()
