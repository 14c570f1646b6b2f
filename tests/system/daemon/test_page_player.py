# SPDX-License-Identifier: Apache-2.0
"""Recordings and results in the live page, in a real browser."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.export import describe
from hueflight.files.image_schema import SERIES_DIM
from hueflight.simulator import simulate_capture
from support.browser import open_browser, require_chromium, wait
from support.daemon_process import PATIENCE_S, Daemon, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
FRAMES = 8000  # two seconds


def text_of(page: Any, selector: str) -> str:
    return page.text_content(selector)


def play(page: Any, name: str) -> None:
    page.keyboard.press("l")
    page.click(f"[data-name='{name}'] button:text('Play')")
    wait(page, "#playing", name)
    page.focus("#view")


def saved_of(page: Any, name: str) -> Any:
    """The table of all pixels, once the picture is shown whose name it has."""
    for _ in range(100):
        with page.expect_download() as download:
            page.select_option("#save", "csv")
        if download.value.suggested_filename == name:
            return download.value
        page.wait_for_timeout(100)
    raise AssertionError(f"{name} was never shown")


def test_a_recording_is_played(page: Any, daemon: Daemon) -> None:
    daemon.post("/api/recordings", {"name": "film", "frames": FRAMES})
    until(lambda: daemon.status()["recording"]["last"].get("name") == "film", "it is recorded")
    play(page, "film")
    wait(page, "#place-in-file", "1.00 of 2.00 s")
    until(lambda: "film" in page.title(), "the title names it")
    assert page.is_hidden("#integration")
    page.keyboard.press("ArrowRight")
    wait(page, "#pixel-note", "in 4000 frames")  # a second of them
    page.keyboard.press("End")
    wait(page, "#place-in-file", "2.00 of 2.00 s")
    page.select_option("#span", "Infinity")
    wait(page, "#pixel-note", f"in {FRAMES} frames")
    with hf.open_recording(daemon.data / "recordings/film.mcap") as recording:  # pyright: ignore[reportAttributeAccessIssue]
        photons = FRAMES - int(recording.histogram()[24, 17, 0])
    assert f"{photons:,} photons" in text_of(page, "#pixel-note")
    page.select_option("#span", "0.1")
    page.focus("#view")
    page.keyboard.press("Home")
    wait(page, "#place-in-file", "0.10 of 2.00 s")
    page.keyboard.press(".")
    wait(page, "#place-in-file", "0.20 of 2.00 s")
    page.keyboard.press(",")
    wait(page, "#place-in-file", "0.10 of 2.00 s")
    page.select_option("#speed", "0.25")
    page.focus("#view")
    page.keyboard.press(" ")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    until(lambda: not text_of(page, "#place-in-file").startswith("0.10"), "it is played")
    page.keyboard.press(" ")
    assert page.get_attribute("#play", "aria-pressed") == "false"
    page.select_option("#speed", "10")
    page.check("#loop")
    page.click("#play")
    places: set[str] = set()

    def both_ends_were_seen() -> bool:
        places.add(text_of(page, "#place-in-file"))
        return {"0.10 of 2.00 s", "2.00 of 2.00 s"} <= places

    until(both_ends_were_seen, "it begins again at its end")
    page.uncheck("#loop")
    page.wait_for_function("() => document.querySelector('#play').textContent.includes('Play')")
    wait(page, "#place-in-file", "2.00 of 2.00 s")
    for key in "12345":  # every view
        page.focus("#view")
        page.keyboard.press(key)
    for width in (390, 320, 1366):  # two phones and a laptop
        page.set_viewport_size({"width": width, "height": 768})
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.keyboard.press("Escape")
    assert page.is_hidden("#player")
    page.wait_for_selector("#stale", state="hidden")
    wait(page, "#gathered", " s")
    made = daemon.status()["picture"]["number"]
    wait(page, "#state", "live")
    until(lambda: daemon.status()["picture"]["number"] > made, "pictures are live again")


def test_results_are_shown(page: Any, daemon: Daemon, fast_instrument: Path) -> None:
    data: Path = daemon.data  # pyright: ignore[reportAttributeAccessIssue]
    calibration = hf.Calibration.load(next(data.glob("calibrations/*/calibration.zarr")))
    instrument = hf.Instrument.load(fast_instrument)
    counts = [simulate_capture("reference", instrument, frames=4000, seed=s) for s in (1, 2)]
    images = [describe(hf.reconstruct(each, calibration), calibration) for each in counts]
    (data / "results").mkdir()
    series = xr.concat(images, SERIES_DIM, combine_attrs="override")
    hf.write_image(series, data / "results/series.zarr")
    np.save(data / "results/counts.npy", counts[0])
    play(page, "series.zarr")
    for number, image in enumerate(images, 1):
        wait(page, "#place-in-file", f"{number} of 2")
        page.wait_for_function(
            "n => document.querySelector('#stale').hidden && "
            "document.querySelector('#seek').value == n",
            arg=number,
        )
        download = saved_of(page, f"series.zarr-{number - 1}.csv")
        rows = list(csv.DictReader(Path(download.path()).read_text().splitlines()))
        found = np.array([float(row["depth_m"] or "nan") for row in rows])
        np.testing.assert_allclose(found, image.depth.values.ravel(), atol=1e-3)
        page.focus("#view")
        page.keyboard.press(".")
    page.keyboard.press("ArrowRight")
    wait(page, "#pixel-depth", " m")
    page.click("#close-file")
    assert page.is_hidden("#player")

    held: list[Any] = []
    page.route("**/api/playback/series.zarr/picture*", lambda route: held.append(route))
    play(page, "series.zarr")
    until(lambda: page.wait_for_timeout(10) is None and len(held) == 1, "its picture is on its way")
    play(page, "counts.npy")  # another file is opened meanwhile
    held[0].continue_()
    wait(page, "#place-in-file", "1 of 1")
    page.wait_for_selector("#stale", state="hidden")  # its picture is shown
    page.unroute("**/api/playback/series.zarr/picture*")

    play(page, "series.zarr")
    wait(page, "#place-in-file", "1 of 2")
    page.clock.install(time=0)
    page.clock.pause_at(1000)
    for _ in range(3):  # play, pause, play
        page.keyboard.press(" ")
        page.wait_for_timeout(300)
    until(
        lambda: page.clock.run_for(100) is None and text_of(page, "#place-in-file") == "2 of 2",
        "it plays",
    )
    assert page.get_attribute("#play", "aria-pressed") == "true"  # once only: it is not at its end


def test_who_may_only_look_can_change_nothing(
    start_simulated: Callable[..., Daemon], tmp_path: Path
) -> None:
    require_chromium()
    for role in ("operator", "viewer"):
        (tmp_path / role).write_text(f"a-token-for-tests-only-{role}")
        (tmp_path / role).chmod(0o600)
    tokens = f'token_file = "{tmp_path}/operator"\nviewer_token_file = "{tmp_path}/viewer"'
    daemon = start_simulated(tmp_path / "data", server=tokens)
    with open_browser(tmp_path / "profile") as browser:
        for role, may in (("operator", True), ("viewer", False)):
            page = browser.new_context().new_page()
            page.set_default_timeout(PATIENCE_S * 1e3)
            page.goto(f"{daemon.url}/#token=a-token-for-tests-only-{role}")
            wait(page, "#state", "live")
            for name in ("run", "record", "calibrate", "integration", "method"):
                page.wait_for_function(
                    "([n, may]) => document.getElementById(n).disabled === !may", arg=[name, may]
                )
            page.keyboard.press("r")
            assert page.is_visible("#record-dialog") == may
            if not may:
                wait(page, "#message", "you may look and change nothing")
            page.context.close()
