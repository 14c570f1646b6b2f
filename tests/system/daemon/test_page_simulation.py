# SPDX-License-Identifier: Apache-2.0
"""What a newcomer sees: a simulated camera that nobody has calibrated, and what it can do."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from support.browser import open_browser, require_chromium, wait
from support.daemon_process import PATIENCE_S, Daemon, until
from support.small_daemon import small_instrument

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


def test_depth_comes_first_and_everything_can_be_moved(tmp_path: Path) -> None:
    require_chromium()
    instrument = small_instrument(tmp_path, rows=24, cols=16)
    config = tmp_path / "daemon.toml"
    config.write_text(
        f'instrument = "{instrument}"\ndata = "{tmp_path}/data"\nsimulate = true\n'
        "[server]\nport = 0\n"
    )
    daemon = Daemon(config, {})
    try:
        with open_browser(tmp_path / "profile") as browser:
            page = browser.new_context(viewport={"width": 1366, "height": 768}).new_page()
            page.set_default_timeout(PATIENCE_S * 1e3)
            page.goto(daemon.url)
            wait(page, "#state", "live")
            wait(page, "#f-calibration", "calibrated by simulation")
            page.focus("#view")
            page.keyboard.press("ArrowRight")
            wait(page, "#pixel-depth", " m ± ")
            until(lambda: daemon.status()["picture"]["frames"]["least"] > 2000, "photons add up")

            page.click("#simulated")
            page.check("#moving")
            until(lambda: daemon.status()["simulation"]["moving"], "the ball moves")
            until(
                lambda: daemon.status()["picture"]["frames"]["least"] < 1000, "the picture follows"
            )
            page.select_option("#drift", "100")
            wait(page, "#simulation-note", "LED light is late by")
            assert daemon.status()["simulation"]["drift_ps_per_s"] == 100
            page.select_option("#drift", "0")
            page.uncheck("#moving")
            until(lambda: not daemon.status()["simulation"]["moving"], "the ball is gone")

            page.uncheck("#plugged")
            wait(page, "#state", "no camera")
            page.check("#plugged")
            wait(page, "#state", "live")
            page.click("#simulation-close")
            wait(page, "#gap-count", "1")
    finally:
        daemon.end(signal.SIGKILL)
