# SPDX-License-Identifier: Apache-2.0
"""Every control of the live page in a real browser, on a daemon with a simulated camera."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from support.browser import open_browser, require_chromium, wait
from support.daemon_process import PATIENCE_S, Daemon, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
SHARE_DRAWN = """() => {
  const shown = document.getElementById("cloud").hidden ? "plane" : "cloud";
  const copy = new OffscreenCanvas(300, 300), c = copy.getContext("2d");
  c.drawImage(document.getElementById(shown), 0, 0, 300, 300);
  const pixels = c.getImageData(0, 0, 300, 300).data;
  let bright = 0;
  for (let i = 0; i < pixels.length; i += 4) {
    if (Math.max(pixels[i], pixels[i + 1], pixels[i + 2]) > 40) bright++;
  }
  return (4 * bright) / pixels.length;
}"""


def drag(page: Any, begin: tuple[float, float], end: tuple[float, float], *on: str) -> None:
    """Drag over an element, between places that are shares of its size."""
    box = page.locator(on[0] if on else "#view").bounding_box()
    for place, act in ((begin, page.mouse.down), (end, page.mouse.up)):
        page.mouse.move(box["x"] + place[0] * box["width"], box["y"] + place[1] * box["height"])
        act()


def saved(page: Any, what: str) -> bytes:
    """What the browser saves."""
    with page.expect_download() as download:
        page.select_option("#save", what)
    return Path(download.value.path()).read_bytes()


def test_how_pictures_are_made(page: Any) -> None:
    wait(page, "#gathered", " s")
    page.select_option("#integration", "1")
    until(lambda: page.daemon.status()["picture"]["integration_s"] == 1, "a limit of one second")
    page.select_option("#method", "pooled")
    until(lambda: page.daemon.status()["picture"]["method"] == "pooled", "pooled is used")
    page.select_option("#integration", "null")
    until(lambda: page.daemon.status()["picture"]["integration_s"] is None, "no limit")
    page.select_option("#method", "joint")
    page.daemon.post("/api/picture", {"integration_s": 7})
    page.focus("#view")
    page.wait_for_function("() => document.querySelector('#integration').value === '7'")


def test_what_is_shown_of_pixels_that_know_little(page: Any) -> None:
    until(lambda: page.evaluate(SHARE_DRAWN) > 0.5, "most pixels are drawn")
    page.locator("#limit").fill("0")  # 1 mm
    wait(page, "#limit-value", "1.0 mm")
    until(lambda: page.evaluate(SHARE_DRAWN) < 0.1, "they fade")
    page.uncheck("#fade")
    until(lambda: page.evaluate(SHARE_DRAWN) > 0.5, "they do not fade")
    page.keyboard.press("4")
    until(lambda: page.evaluate(SHARE_DRAWN) < 0.01, "uncertain points are left out")
    page.locator("#limit").fill("60")
    wait(page, "#limit-value", "any")
    until(lambda: page.evaluate(SHARE_DRAWN) > 0.02, "all points are shown")
    assert page.is_visible("#axes")
    page.select_option("#hatched", "any")
    page.focus("#view")
    page.keyboard.press("+")
    page.click("#reset-points")
    page.focus("#view")
    page.keyboard.press("1")
    page.select_option("#hatched", "misfit")


def test_the_scale(page: Any) -> None:
    page.fill("#bar-low", "0.5")
    page.fill("#bar-high", "1.5")
    page.keyboard.press("Tab")
    assert page.is_checked("#lock")
    drag(page, (0.98, 0.5), (0.98, 0.5), "#bar-histogram")
    page.wait_for_function("() => Math.abs(document.querySelector('#bar-high').value - 1.5) > 0.01")
    page.check("#logarithmic")
    for name in ("viridis, reversed", "gray", "gray, reversed", "stripes", "viridis"):
        page.select_option("#map", name)
    page.focus("#view")
    page.keyboard.press("5")
    wait(page, "#bar-unit", "photons per frame")


COLORS_DRAWN = """() => {
  const canvas = document.getElementById("materials");
  if (canvas.hidden || canvas.width < 2) return 0;
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return new Set(new Uint32Array(data.buffer)).size;
}"""


def test_maps_of_materials(page: Any) -> None:
    page.wait_for_selector("#materials-tab", state="visible")
    page.keyboard.press("6")
    until(lambda: page.evaluate(COLORS_DRAWN) > 20, "a map is drawn")
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + 40, box["y"] + 40)
    wait(page, "#hover", "abundance of red: ")
    page.select_option("#material", "abundance_blue")
    page.focus("#view")
    until(lambda: page.evaluate(COLORS_DRAWN) > 20, "the other one is drawn")
    assert saved(page, "png").startswith(b"\x89PNG")
    page.focus("#view")
    page.keyboard.press("1")
    page.wait_for_function("() => document.getElementById('materials').hidden")


def test_measuring_and_saving(page: Any) -> None:
    page.keyboard.press("ArrowRight")
    page.keyboard.press("g")
    drag(page, (0.05, 0.8), (0.45, 0.95))
    wait(page, "#region-depth", "depth ")
    wait(page, "#region-spectrum", "659 nm ")
    wait(page, "#region-place", "8 × 14 pixels at row 38, column 1")
    page.keyboard.press("d")
    for place in ((0.1, 0.9), (0.9, 0.9)):
        drag(page, place, place)
    wait(page, "#distance-text", "Distance ")
    page.mouse.move(5, 5)
    assert page.is_hidden("#hover")
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    wait(page, "#hover", "row 24, column 16")
    wait(page, "#series-now", "pictures")
    page.select_option("#series-of", "photons")

    page.focus("#view")
    page.keyboard.press("f")
    assert page.get_attribute("#freeze", "aria-pressed") == "true"
    page.wait_for_timeout(500)  # pictures that were on their way
    rows = list(csv.DictReader(saved(page, "csv").decode().splitlines()))
    assert len(rows) == 48 * 32
    known = [float(row["depth_m"]) for row in rows if row["depth_m"]]
    assert len(known) > 500
    assert 0.6 < sorted(known)[len(known) // 2] < 1.1  # the scene is at 0.7 to 1 m
    assert saved(page, "csv").decode().splitlines()[1] == ",".join(rows[0].values())
    assert saved(page, "png").startswith(b"\x89PNG")
    page.locator("#limit").fill("60")
    points = saved(page, "ply").decode().splitlines()
    assert int(re.search(r"vertex (\d+)", "\n".join(points)).group(1)) == len(known)
    assert len(points) - points.index("end_header") - 1 == len(known)
    assert saved(page, "series").startswith(b"number,unix_s,depth,")
    page.focus("#view")
    page.keyboard.press("f")
    page.keyboard.press("?")
    wait(page, "#keys", "measure a region")
    page.keyboard.press("Escape")


def test_recordings(page: Any, daemon: Any) -> None:
    questions: list[str] = []
    answers = iter([False, "renamed", False, True])

    def answer(dialog: Any) -> None:
        questions.append(dialog.message)
        said = next(answers)
        if said is False:
            dialog.dismiss()
        elif said is True:
            dialog.accept()
        else:
            dialog.accept(said)

    page.on("dialog", answer)
    page.keyboard.press("r")
    page.fill("#record-name", "first")
    page.fill("#record-note", "by hand")
    page.keyboard.press("Enter")
    wait(page, "#recording", "first")
    page.focus("#view")
    page.keyboard.press(" ")  # the question is answered with no
    until(lambda: len(questions) == 1, "it asks")
    assert "The recording first is in progress" in questions[0]
    assert page.daemon.status()["recording"]["name"] == "first"
    page.keyboard.press("r")
    wait(page, "#f-disk", "last: first")

    page.keyboard.press("r")
    page.fill("#record-name", "second")
    page.select_option("#record-rule", "frames")
    page.fill("#record-limit", "500")
    page.keyboard.press("Enter")
    wait(page, "#f-disk", "last: second")
    page.focus("#view")
    page.keyboard.press("l")
    page.wait_for_selector("[data-name=second]")
    text = page.inner_text("[data-name=first]")
    assert "scene: by hand" in text
    assert "500 frames" in page.inner_text("[data-name=second]")
    for width in (390, 320):  # on a phone, all buttons can be reached without scrolling sideways
        page.set_viewport_size({"width": width, "height": 844})
        widths = "list => [list.scrollWidth, list.clientWidth]"
        needed, given = page.eval_on_selector(".scrolls:has(#recordings-list)", widths)
        assert needed <= given
    with page.expect_download() as download:
        page.click("[data-name=second] button:text('Download')")
    kept = daemon.data / "recordings/second.mcap"
    assert Path(download.value.path()).read_bytes() == kept.read_bytes()
    assert download.value.suggested_filename == "second.mcap"
    page.click("[data-name=second] button:text('Rename')")
    page.wait_for_selector("[data-name=renamed]")
    page.click("[data-name=renamed] button:text('Delete')")
    until(lambda: len(questions) == 3, "it asks")
    assert (daemon.data / "recordings/renamed.mcap").exists()
    page.click("[data-name=renamed] button:text('Delete')")
    page.wait_for_selector("[data-name=renamed]", state="detached")
    assert not (daemon.data / "recordings/renamed.mcap").exists()
    page.click("#recordings-close")


def test_the_camera_is_set(page: Any) -> None:
    page.keyboard.press("ArrowRight")
    page.keyboard.press("g")
    drag(page, (0.05, 0.05), (0.95, 0.95))
    wait(page, "#region-place", "pixels at row 2, column 1")
    page.keyboard.press("o")
    page.fill("#rate", "2000")
    page.click("#controls-region")
    page.click("#controls-mask")
    wait(page, "#masked", "1: 24/17")
    page.fill("#gate-last", "400")
    page.click("#controls-dialog .primary")
    until(lambda: page.daemon.get("/api/controls")["rate_hz"] == 2000, "the camera is set")
    found = page.daemon.get("/api/controls")
    assert (found["rows"], found["cols"], found["gate"]) == ([2, 45], [1, 30], [0, 400])
    assert found["masked"] == [[24, 17]]
    page.focus("#view")
    page.keyboard.press("o")
    page.wait_for_function("() => document.querySelector('#rows-last').value === '45'")
    page.click("#controls-unmask")
    wait(page, "#masked", "none")
    page.click("#controls-cancel")
    page.focus("#view")
    page.keyboard.press("o")
    page.click("#controls-default")
    until(lambda: page.daemon.get("/api/controls")["rows"] is None, "the defaults are back")
    assert page.daemon.get("/api/controls")["masked"] == []


def test_the_schedule_of_the_leds_is_set(page: Any) -> None:
    """Depth goes with the schedule of its calibration, and comes back with it."""
    page.keyboard.press("ArrowRight")
    wait(page, "#pixel-depth", " m")
    page.keyboard.press("o")
    page.click("#schedule summary")
    page.locator("#delays input").nth(1).fill("wrong")
    page.click("#controls-set")
    # the browser says so, and nothing is sent
    assert page.locator("#delays input:invalid").count() == 1
    page.locator("#delays input").nth(1).fill("55")  # until after the third band begins
    page.click("#controls-set")
    wait(page, "#message", "coincide")
    page.focus("#view")
    page.keyboard.press("o")
    page.click("#schedule summary")
    wait(page, "#schedule-note", "in steps of 1.25 ns, at most 4 for each LED")
    for width in (390, 320, 1366):  # two phones and a laptop
        page.set_viewport_size({"width": width, "height": 768})
        widths = "dialog => [dialog.scrollWidth, dialog.clientWidth]"
        needed, given = page.eval_on_selector("#controls-dialog", widths)
        assert needed <= given
    page.locator("#delays input").nth(1).fill("35")
    page.locator("#delays input").nth(8).fill("245")
    page.click("#controls-set")
    wait(page, "#message", "The camera was set")
    schedule = page.daemon.get("/api/controls")["schedule"]
    assert [delays[0] for delays in schedule["delays_ns"]] == [0, 35, *range(60, 240, 30), 245]
    wait(page, "#f-calibration", "by simulation")  # no other one fits
    page.focus("#view")
    page.keyboard.press("o")
    page.wait_for_function(
        "() => document.querySelector('#delays label:last-child input').value === '245'"
    )
    page.fill("#period", "300")
    page.click("#controls-set")
    until(lambda: page.daemon.get("/api/controls")["schedule"]["period_ns"] == 300, "the period")
    page.focus("#view")
    page.keyboard.press("o")
    page.click("#controls-default")
    until(lambda: page.daemon.get("/api/controls")["schedule"] is None, "the default is back")
    wait(page, "#f-calibration", "calibrated at 0.4 m")
    wait(page, "#pixel-depth", " m")


@pytest.mark.parametrize("size", [(1366, 768), (3840, 2160), (390, 844), (320, 640)])
def test_nothing_is_wider_than_the_screen(page: Any, size: tuple[int, int]) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    for key in "1234":
        page.keyboard.press(key)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    box = page.locator("#view").bounding_box()
    assert box["width"] > 0.4 * size[0]  # the picture uses the space


def test_a_wrong_token_is_told_from_a_daemon_that_is_gone(
    start_simulated: Callable[..., Daemon], tmp_path: Path
) -> None:
    require_chromium()
    token = tmp_path / "token"
    token.write_text("a-token-for-tests-only")
    token.chmod(0o600)
    daemon = start_simulated(tmp_path / "data", server=f'token_file = "{token}"')
    with open_browser(tmp_path / "profile") as browser:
        page = browser.new_context().new_page()
        page.set_default_timeout(PATIENCE_S * 1e3)
        page.goto(daemon.url)
        wait(page, "#token-note", "requires a token")
        page.fill("#token", "not-the-right-token")
        page.keyboard.press("Enter")
        wait(page, "#token-note", "The token is wrong")
        page.fill("#token", "a-token-for-tests-only")
        page.keyboard.press("Enter")
        wait(page, "#state", "live")
        daemon.end()
        wait(page, "#state", "daemon not reachable")
        assert not page.evaluate("document.querySelector('#token-dialog').open")
