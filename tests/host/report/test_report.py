# SPDX-License-Identifier: Apache-2.0
"""The demo report on a small sensor: complete, self-contained, and true to its numbers."""

import json
import re
from pathlib import Path

import msgspec
import pytest

from hueflight import Instrument
from hueflight.report import FurtherPage, make_report
from hueflight.report.report import SECTIONS


@pytest.fixture(scope="module")
def small() -> Instrument:
    """The paper's instrument with 4 × 4 pixels joined to one."""
    paper = Instrument.load("paper")
    sensor = msgspec.structs.replace(
        paper.sensor, rows=48, cols=32, pixel_width_um=73.6, pixel_height_um=36.8
    )
    return paper.replace(name="small", sensor=sensor)


@pytest.fixture(scope="module")
def report(small: Instrument, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    out = tmp_path_factory.mktemp("report")
    pages = {"more.html": FurtherPage("Look <closer>", lambda found: f"{found.main.frames} frames")}
    return out, make_report(out, instrument=small, frames=10_000, pages=pages)


def test_every_figure_is_a_picture_of_its_own_and_in_the_page(report: tuple[Path, dict]) -> None:
    out, _ = report
    page = (out / "index.html").read_text("utf-8")
    assert {path.stem for path in out.glob("*.png")} == {section.name for section in SECTIONS}
    for path in out.glob("*.png"):
        assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert page.count('src="data:image/png;base64,') == len(SECTIONS)
    links = re.findall(r'(?:src|href)="(?!data:)([^"]*)', page)
    assert links == ["more.html"], "the page must need nothing else"
    assert "$" not in page, "every placeholder is filled"


def test_the_table_stands_beside_the_papers_figures(report: tuple[Path, dict]) -> None:
    out, numbers = report
    page = (out / "index.html").read_text("utf-8")
    assert "3.41 cm" in page
    assert "0.64 cm" in page
    assert f"{numbers['background_row_deviation_cm']:.2f} cm" in page
    assert json.loads((out / "figures.json").read_text()) == pytest.approx(numbers)


def test_numbers_are_those_of_a_working_instrument(report: tuple[Path, dict]) -> None:
    """Bounds, not guesses: no spread may lie below Cramér–Rao by more than its own scatter.

    A spread from n values scatters by 1/sqrt(2n): 13 % for 30 columns, 14 % for 25 distances;
    0.6 × the bound is three of those below it. The upper limits are twice what was measured for
    the paper's method (1.03 to 1.4 × the bound), and four scatters above the bound, plus the
    noise of the reference, for the joint fit.
    """
    _, numbers = report
    assert numbers["wire_identical"] == 1
    row = numbers["background_row_deviation_cm"] / numbers["background_row_bound_cm"]
    assert 0.6 < row < 2.8
    joint = numbers["background_row_joint_deviation_cm"] / numbers["background_row_bound_cm"]
    assert 0.6 < joint < 1.7
    assert 0.6 < numbers["ranging_joint_deviation_cm"] / numbers["ranging_bound_cm"] < 1.6
    fine = numbers["ranging_deviation_cm"] / numbers["ranging_bound_cm"]
    assert 0.6 < fine < 2.8


def test_a_further_page_is_written_and_linked(report: tuple[Path, dict]) -> None:
    out, _ = report
    assert (out / "more.html").read_text("utf-8") == "10000 frames"
    page = (out / "index.html").read_text("utf-8")
    assert '<a class="onward" href="more.html">Look &lt;closer&gt;</a>' in page


def test_the_joint_fit_is_nearer_to_the_truth_and_says_how_near(report: tuple[Path, dict]) -> None:
    """Of 1200 lit pixels, 68.3 % lie within one deviation; five scatters are 6.7 %."""
    _, numbers = report
    assert numbers["reflectance_joint_error_percent"] < 0.5 * numbers["reflectance_error_percent"]
    assert numbers["few_frames_pooled_error_cm"] < numbers["few_frames_error_cm"]
    assert 61.6 < numbers["within_joint_deviation_percent"] < 75.0
