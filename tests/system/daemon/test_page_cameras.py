# SPDX-License-Identifier: Apache-2.0
"""Several cameras in one page, in a real browser."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from support.browser import open_browser, require_chromium, wait
from support.daemon_process import PATIENCE_S, Daemon, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
TOKEN = "a-token-for-tests-only"
COLOURS_IN_TILE = """(number) => {
  const canvas = document.querySelector(`[data-number="${number}"] canvas`);
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const seen = new Set();
  for (let i = 0; i < pixels.length; i += 4) seen.add(pixels[i] << 8 | pixels[i + 1]);
  return seen.size;
}"""


def status_of(daemon: Daemon) -> Any:
    request = urllib.request.Request(
        f"{daemon.url}/api/status", headers={"authorization": f"Bearer {TOKEN}"}
    )
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.loads(answer.read())


def test_two_cameras_are_seen_and_started_together(
    start_simulated: Callable[..., Daemon], tmp_path: Path
) -> None:
    require_chromium()
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    other = start_simulated(tmp_path / "other", server=f'token_file = "{token}"')
    named = f'[[cameras]]\naddress = "{other.url}"\ntoken_file = "{token}"'
    own = start_simulated(tmp_path / "own", recording=f"min_free_mb = 1\n{named}")
    with open_browser(tmp_path / "profile") as browser:
        page = browser.new_context(viewport={"width": 1366, "height": 768}).new_page()
        page.set_default_timeout(PATIENCE_S * 1e3)
        failures: list[str] = []
        page.on("pageerror", lambda error: failures.append(str(error)))
        page.goto(own.url)
        page.click("#cameras")
        for number in (0, 1):
            wait(page, f"[data-number='{number}'] .pill", "live")
            until(lambda n=number: page.evaluate(COLOURS_IN_TILE, n) > 20, "a picture is drawn")
            for view in ("photons", "colour", "depth"):
                page.select_option("#all-view", view)
        page.click("#all-stop")
        wait(page, "#together", "2 of 2 stopped, all within")
        for number in (0, 1):
            wait(page, f"[data-number='{number}'] .pill", "stopped")
        assert (own.status()["state"], status_of(other)["state"]) == ("idle", "idle")
        page.click("#all-start")
        wait(page, "#together", "2 of 2 started")
        until(lambda: status_of(other)["state"] == "running", "the other one runs")
        page.click("#all-record")
        wait(page, "#together", "2 of 2 record")
        until(lambda: own.status()["recording"]["frames"] > 0, "this one records")
        until(lambda: status_of(other)["recording"]["frames"] > 0, "the other one records")
        page.click("#all-end")
        until(lambda: bool(status_of(other)["recording"]["last"]), "the recording has ended")
        until(lambda: bool(own.status()["recording"]["last"]), "the recording has ended")
        for width in (390, 1366, 3840):
            page.set_viewport_size({"width": width, "height": 844})
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), width
        other.end()
        wait(page, "[data-number='1'] .pill", "daemon not reachable")
        page.wait_for_function(
            "() => document.querySelector('[data-number=\"0\"] .stale').textContent === ''"
        )
        assert not failures
