# SPDX-License-Identifier: Apache-2.0
"""The live page in a real browser, on a daemon on real USB stacks."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hueflight.daemon.http.server import REQUEST_S
from hueflight.emulation import CameraModel, FrameBank
from hueflight.recording import open_recording
from support.browser import open_browser, require_chromium, wait
from support.daemon_process import PATIENCE_S, Daemon, until

Start = Callable[[], Daemon]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
LONGER_S = REQUEST_S + 2.0  #: than any limit of a request
COLOURS_ON_THE_PLANE = """() => {
  const canvas = document.getElementById("plane"), { width, height } = canvas;
  const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
  const seen = new Set();
  for (let i = 0; i < pixels.length; i += 4) {
    seen.add(pixels[i] << 16 | pixels[i + 1] << 8 | pixels[i + 2]);
  }
  return seen.size;
}"""


@pytest.fixture
def page(start_daemon: Start, tmp_path: Path) -> Iterator[Any]:
    """The page of a running daemon; errors in its console fail the test."""
    require_chromium()
    daemon = start_daemon()
    with open_browser(tmp_path / "profile") as browser:
        context = browser.new_context(viewport={"width": 1280, "height": 860}, color_scheme="dark")
        opened = context.new_page()
        opened.set_default_timeout(PATIENCE_S * 1e3)
        failures: list[str] = []
        opened.on("pageerror", lambda error: failures.append(str(error)))
        opened.sockets = []
        opened.on("websocket", lambda made: opened.sockets.append(made))
        opened.goto(daemon.url)
        opened.daemon = daemon
        yield opened
    assert not failures


def test_a_session_at_the_instrument(
    page: Any, bus: Any, model: CameraModel, banks: dict[str, list[bytes]], tmp_path: Path
) -> None:
    """Start, calibrate, look, inspect, record, unplug, replug, stop; by keyboard throughout."""

    began_s = time.monotonic()
    wait(page, "#state", "live")
    assert page.is_hidden("#simulated")
    wait(page, "#hint", "not calibrated")

    model.bank = FrameBank(banks["reference"])
    page.keyboard.press("c")
    assert page.is_visible("#calibrate-dialog")
    page.fill("#distance", "0.4")
    page.fill("#frames", "2000")
    page.uncheck("#with-bands")
    page.keyboard.press("Enter")
    wait(page, "#f-calibration", "calibrated at 0.4 m")
    model.bank = FrameBank(banks["scene"])
    page.wait_for_selector("#hint", state="hidden")

    page.focus("#view")
    page.keyboard.press("1")
    until(lambda: page.evaluate(COLOURS_ON_THE_PLANE) > 50, "depth is drawn in many colours")
    for key, view in zip("2345", ("colour", "bands", "points", "photons"), strict=True):
        page.keyboard.press(key)
        assert page.get_attribute(f"[data-view={view}]", "aria-selected") == "true"
    page.keyboard.press("2")
    until(lambda: page.evaluate(COLOURS_ON_THE_PLANE) > 50, "all bands together give colours")
    page.wait_for_selector("#three", state="visible")
    page.check("#three")
    until(lambda: page.evaluate(COLOURS_ON_THE_PLANE) > 50, "three bands give colours")
    page.uncheck("#three")
    page.focus("#view")
    page.keyboard.press("1")
    page.wait_for_selector("#three", state="hidden")

    page.keyboard.press("ArrowRight")
    wait(page, "#pixel-place", "row 24, column 17")
    page.keyboard.press("Shift+ArrowUp")
    wait(page, "#pixel-place", "row 16, column 17")
    wait(page, "#pixel-note", "photons in")
    box = page.locator("#view").bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    wait(page, "#pixel-place", "row 24, column 16")
    wait(page, "#pixel-note", "photons in")
    for _ in range(3):
        page.keyboard.press("ArrowLeft")
    wait(page, "#pixel-place", "row 24, column 13")
    wait(page, "#pixel-depth", " m")

    page.keyboard.press("r")
    page.keyboard.press("Enter")
    page.wait_for_selector("#recording", state="visible")
    name = page.daemon.status()["recording"]["name"]
    until(lambda: page.daemon.status()["recording"]["frames"] > 200, "frames are recorded")
    page.keyboard.press("r")
    wait(page, "#f-disk", f"last: {name}")
    with open_recording(tmp_path / f"data/recordings/{name}.mcap") as recording:
        assert recording.info().as_dict()["report"]["frames"] > 200

    wait(page, "#state", "live")
    page.wait_for_selector("#stale", state="hidden")
    before = page.daemon.status()["totals"]["delivered"]
    until(lambda: page.daemon.status()["totals"]["delivered"] > before, "the live run is on")
    bus.unplug()
    wait(page, "#state", "no camera")
    wait(page, "#stale", "No camera.")
    assert "old" in page.get_attribute("#view", "class")
    bus.plug()
    wait(page, "#state", "live")
    page.wait_for_selector("#stale", state="hidden")
    wait(page, "#gap-count", "1")
    assert page.is_hidden("#problem")
    assert "bad" in page.get_attribute("#f-lost", "class")

    page.keyboard.press(" ")
    wait(page, "#state", "stopped")
    wait(page, "#stale", "Stopped.")
    page.keyboard.press(" ")
    wait(page, "#state", "live")

    theme = page.get_attribute("html", "data-theme")
    page.keyboard.press("t")
    assert page.get_attribute("html", "data-theme") != theme

    for width, height in ((390, 844), (320, 640), (1280, 720)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), width

    page.wait_for_timeout(1e3 * max(0.0, began_s + LONGER_S - time.monotonic()))
    assert len(page.sockets) == 1, "the page lost its live socket"
    page.daemon.end(signal.SIGKILL)
    wait(page, "#state", "daemon not reachable")
    wait(page, "#stale", "The daemon is not reachable.")


def test_tabs_and_buttons_are_reached_by_tab_alone(page: Any) -> None:
    wait(page, "#state", "live")
    reached = []
    for _ in range(24):
        page.keyboard.press("Tab")
        reached.append(
            page.evaluate("document.activeElement.id || document.activeElement.dataset.view")
        )
    for wanted in ("run", "record", "calibrate", "theme", "depth", "photons", "view", "lock"):
        assert wanted in reached, wanted
