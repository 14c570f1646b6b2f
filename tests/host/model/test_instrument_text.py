# SPDX-License-Identifier: Apache-2.0
"""TOML that is written is read as an equal instrument; the documents list every entry."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hueflight.model.instrument import Band, Instrument, Lens, Sensor, Timing
from hueflight.model.instrument_text import entries
from support.browser import open_browser

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("name", Instrument.presets())
def test_presets_survive(name):
    preset = Instrument.load(name)
    assert Instrument.from_toml(preset.to_toml()) == preset


POSITIVE = st.floats(1e-3, 1e6, allow_nan=False)


@given(
    text=st.text(max_size=30),
    widths=st.tuples(POSITIVE, POSITIVE),
    delays=st.lists(st.floats(0, 1e3), min_size=1, max_size=4),
    lens=st.booleans(),
)
def test_any_instrument_survives(text, widths, delays, lens):
    made = Instrument(
        name=text,
        description=text[::-1],
        sensor=Sensor(
            rows=3, cols=4, code_bits=5, bin_width_ns=widths[0], pixel_width_um=1.5,
            pixel_height_um=widths[1], detection_wavelength_nm=(400, 500.5),
            detection_probability=(0.1, 0.25),
        ),
        timing=Timing(latency_ns=delays[0]),
        bands=(Band(name=text, wavelength_nm=640, delay_ns=tuple(delays), emission_fwhm_nm=0.1),),
        lens=Lens(focal_length_mm=8.25) if lens else None,
    )  # fmt: skip
    assert tomllib.loads(made.to_toml())["name"] == text
    assert Instrument.from_toml(made.to_toml()) == made


def test_every_entry_is_documented_with_its_default():
    for section in (Instrument, Sensor, Timing, Lens, Band):
        fields = {field.name: field for field in msgspec.structs.fields(section)}
        for entry in entries(section):
            field = fields[entry.name]
            assert entry.meaning.endswith(".")
            assert (entry.default == "required") == field.required
            if not field.required and field.default not in (None, ()):
                assert tomllib.loads(f"v = {entry.default}")["v"] == field.default


def test_the_page_is_current(tmp_path: Path):
    page = ROOT / "docs" / "instrument.md"
    shutil.copy(page, tmp_path)
    tool = ROOT / "tools" / "instrument_docs.py"
    subprocess.run([sys.executable, tool, tmp_path / page.name], check=True)
    assert (tmp_path / page.name).read_text() == page.read_text(), "run tools/instrument_docs.py"


def test_a_width_that_is_not_stated_counts_as_the_usual_one():
    """So that calibrations of version 0.1.0, which stored 20 nm, still fit their instrument."""

    def with_width(width):
        band = Band(name="red", wavelength_nm=640, emission_fwhm_nm=width)
        sensor = Sensor(rows=1, cols=1, code_bits=4, bin_width_ns=1)
        return Instrument(name="x", sensor=sensor, bands=(band,))

    silent, usual, laser = with_width(None), with_width(20), with_width(0.1)
    assert silent.fingerprint() == usual.fingerprint() != laser.fingerprint()
    assert not silent.differences(usual)
    assert silent.differences(laser)


def many_bands() -> Instrument:
    bands = tuple(
        Band(name=f"line {number}", wavelength_nm=400 + 15 * number, delay_ns=10 * number)
        for number in range(30)
    )
    paper = Instrument.load("paper")
    return paper.replace(bands=bands, description="A line of text.\n" * 40)


def test_an_instrument_of_30_bands_fits_on_one_screen(tmp_path: Path):
    shown = repr(many_bands())
    assert len(shown.splitlines()) <= 24
    assert max(map(len, shown.splitlines())) < 240
    assert "line 10:" in shown
    assert "line 11:" not in shown
    assert "further_bands: 19 more" in shown
    assert "line 29" in str(many_bands().facts()), "facts are complete"
    profile = tmp_path / "profile"
    profile.mkdir()
    with open_browser(profile) as browser:
        page = browser.contexts[0].new_page()
        page.set_viewport_size({"width": 1024, "height": 640})
        page.set_content(many_bands()._repr_html_())
        assert "19 more" in page.inner_text("table")
        box = page.locator("table").bounding_box()
        assert 200 < box["height"] < 620
        assert box["width"] < 1020


def test_one_screen_in_a_terminal_and_in_a_notebook():
    paper = Instrument.load("paper")
    assert len(repr(paper).splitlines()) < 24
    assert "fires at 240 ns" in repr(paper)
    # 192 rows of 9.2 µm behind 8 mm: 2 atan(.8832 / 8)
    assert "12.6°" in repr(paper)
    assert paper.viewing_angles_deg((1, 1)) == pytest.approx((0.1318, 0.0659), abs=1e-4)
    point = paper.replace(sensor=msgspec.structs.replace(paper.sensor, rows=1, cols=1))
    assert "field of view 0.1° × 0.1°" in repr(point)
    page = paper.replace(name="<b>")._repr_html_()
    assert "&lt;b&gt;" in page
    assert "<b>" not in page
