# SPDX-License-Identifier: Apache-2.0
"""Instrument files: the paper's figures, strictness, and errors that say what to do."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from hueflight import Instrument
from hueflight.errors import HueflightError, InstrumentError
from hueflight.model.instrument import Band
from hueflight.model.pulses import full_width_half_maximum

SMALLEST = """
name = "mine"
[sensor]
rows = 2
cols = 3
code_bits = 8
bin_width_ns = 0.5
[[bands]]
name = "green"
wavelength_nm = 525
"""


def test_presets_are_the_five_named() -> None:
    assert Instrument.presets() == ("fine", "fullrate", "line1024", "paper", "spad512")


@pytest.mark.parametrize("name", Instrument.presets())
def test_presets_survive_json(name: str) -> None:
    instrument = Instrument.load(name)
    again = Instrument.from_json(instrument.to_json())
    assert again == instrument
    assert again.fingerprint() == instrument.fingerprint()
    assert instrument.differences(again) == []


def test_table_1_of_the_paper() -> None:
    instrument = Instrument.load("paper")
    assert instrument.histogram_shape == (192, 128, 512)
    table = [(b.wavelength_nm, b.power_mw, b.pulse_fwhm_ns, b.delay_ns) for b in instrument.bands]
    assert table == [
        (659, 3.88, 11.8, 0),
        (632, 1.73, 13.9, 30),
        (623, 1.66, 11.9, 60),
        (597, 0.44, 13.0, 90),
        (525, 1.44, 11.2, 120),
        (498, 1.74, 9.3, 150),
        (469, 2.62, 11.3, 180),
        (445, 4.27, 7.5, 210),
        (418, 4.59, 7.1, 240),
    ]
    for band, row in enumerate(table):
        (pulse,) = instrument.pulses(band)
        assert full_width_half_maximum(pulse.sigma_ns, pulse.tail_ns) == pytest.approx(row[2])
    assert instrument.half_spacing_ns() == 15


def test_field_of_view_of_the_paper() -> None:
    """Appendix: about 16°, 28 cm wide at 1 m; the sensor's 128 pixels of 18.4 µm give 29 cm."""
    right, down = Instrument.load("paper").ray_slopes()
    assert right[0, -1] - right[0, 0] == pytest.approx(0.29, abs=0.01)
    assert np.degrees(2 * np.arctan(right[0, -1])) == pytest.approx(16.6, abs=0.2)
    assert right.mean() == pytest.approx(0, abs=1e-12)
    assert down[-1, 0] > 0 > down[0, 0]


def test_a_scanned_sensor_stacks_its_steps() -> None:
    instrument = Instrument.load("line1024")
    assert instrument.image_shape == (128, 1024)
    assert instrument.ray_cosine().shape == (128, 1024)


def test_a_file_is_enough(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(SMALLEST)
    instrument = Instrument.load(path)
    assert instrument.histogram_shape == (2, 3, 256)
    assert instrument.ray_cosine().tolist() == [[1, 1, 1], [1, 1, 1]]
    assert instrument.half_spacing_ns() == np.inf


def test_half_spacing_counts_the_gap_across_the_period() -> None:
    bands = [{"name": str(d), "wavelength_nm": 500, "delay_ns": d} for d in (5, 100, 310)]
    instrument = msgspec.convert(
        {
            "name": "x",
            "sensor": {"rows": 1, "cols": 1, "code_bits": 10, "bin_width_ns": 0.5},
            "timing": {"period_ns": 320},
            "bands": bands,
        },
        Instrument,
    )
    assert instrument.half_spacing_ns() == 7.5


def test_a_name_does_not_change_the_fingerprint_but_a_delay_does() -> None:
    paper = Instrument.load("paper")
    renamed = paper.replace(name="ours")
    assert renamed.fingerprint() == paper.fingerprint()
    assert paper.differences(renamed) == []
    first = msgspec.structs.replace(paper.bands[0], delay_ns=1.0)
    moved = paper.replace(bands=(first, *paper.bands[1:]))
    assert moved.fingerprint() != paper.fingerprint()
    assert paper.differences(moved) == ["bands[0].delay_ns: 0.0 != 1.0"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("name =", "nam ="), r"there is no entry 'nam'"),
        (("rows = 2", "rows = 2\nfilter = 1"), r"sensor: there is no entry 'filter'"),
        (("wavelength_nm = 525", ""), r"bands\[0\]: the entry 'wavelength_nm' is missing"),
        (("rows = 2", 'rows = "two"'), r"sensor\.rows: a whole number is needed, not text"),
        (("rows = 2", "rows = 0"), r"sensor\.rows = 0: must be at least 1"),
        (("rows = 2", "rows = 2048"), r"2048 × 3 pixels.*split the sensor or use scan_steps"),
        (("code_bits = 8", "code_bits = 17"), r"sensor\.code_bits = 17: must be 1 to 16"),
        (("0.5", "nan"), r"bin_width_ns = nan: must be a finite number above 0"),
        (("525", "-5"), r"band 'green': wavelength_nm = -5.*above 0"),
        (("[sensor]", "[timing]\nperiod_ns = 320\n[sensor]"), r"needs 640 codes.*leave 256"),
        (("525", "525\ndelay_ns = []"), r"delay_ns is empty"),
        (("525", "525\n[lens]\nfocal_length_mm = 8"), r"has a lens but no sensor\.pixel_width"),
        (('name = "mine"', "name = mine"), r"is not TOML"),
        (
            ("[[bands]]", '[[bands]]\nname = "green"\nwavelength_nm = 500\n[[bands]]'),
            r"band names repeat",
        ),
    ],
)
def test_a_bad_file_says_what_is_wrong(change: tuple[str, str], message: str) -> None:
    with pytest.raises(InstrumentError, match=message):
        Instrument.from_toml(SMALLEST.replace(*change), where="mine.toml")


def test_an_unknown_name_lists_the_presets() -> None:
    with pytest.raises(HueflightError, match=r"no instrument 'papper'.*fine, fullrate, line1024"):
        Instrument.load("papper")


def test_a_delay_outside_the_period_is_refused() -> None:
    paper = Instrument.load("paper")
    late = msgspec.structs.replace(paper.bands[0], delay_ns=320.0)
    with pytest.raises(InstrumentError, match=r"delay_ns = 320\.0 lies outside the period"):
        paper.replace(bands=(late, *paper.bands[1:]))


def test_equal_instruments_have_one_fingerprint() -> None:
    point = Band(name="red", wavelength_nm=640.0, delay_ns=(0.0, 5.0), pulse_fwhm_ns=2.0)
    whole = Band(name="red", wavelength_nm=640, delay_ns=(-0.0, 5), pulse_fwhm_ns=2)
    numpy = Band(
        name="red",
        wavelength_nm=np.float32(640),
        delay_ns=(np.int64(0), np.float64(5)),
        pulse_fwhm_ns=np.int32(2),
    )
    instruments = [
        Instrument.load("paper").replace(bands=(band,)) for band in (point, whole, numpy)
    ]
    assert instruments[0] == instruments[1] == instruments[2]
    assert len({instrument.to_json() for instrument in instruments}) == 1
    assert len({instrument.fingerprint() for instrument in instruments}) == 1


@pytest.mark.parametrize(
    ("preset", "fingerprint"),
    [
        ("fine", "f540401fbadf2772"),
        ("fullrate", "db8b7a6e955389a4"),
        ("line1024", "0cba39f9ea336d09"),
        ("paper", "068452d51bd2ad85"),
        ("spad512", "fa48b19b42a95296"),
    ],
)
def test_fingerprints_of_presets_are_fixed(preset: str, fingerprint: str) -> None:
    """Calibrations and images that exist refer to them."""
    assert Instrument.load(preset).fingerprint() == fingerprint


def test_file_that_begins_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(SMALLEST, encoding="utf-8-sig")
    assert Instrument.load(tmp_path / "mine.toml") == Instrument.from_toml(SMALLEST)


def test_a_sensor_without_a_frame_rate_has_one_to_plan_with() -> None:
    sensor = Instrument.load("paper").sensor
    assert sensor.usual_frame_rate_hz == sensor.frame_rate_hz
    assert msgspec.structs.replace(sensor, frame_rate_hz=None).usual_frame_rate_hz == 1000.0
