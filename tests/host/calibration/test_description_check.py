# SPDX-License-Identifier: Apache-2.0
"""Descriptions that are right, and descriptions with one fault each."""

import re

import msgspec
import numpy as np
import pytest

from hueflight.calibration.description_check import check_description
from hueflight.errors import HistogramError
from hueflight.model.instrument import Band, Instrument, Sensor, Timing

BANDS = (
    Band(name="red", wavelength_nm=640, delay_ns=5, pulse_fwhm_ns=2, power_mw=1),
    Band(name="green", wavelength_nm=530, delay_ns=20, pulse_fwhm_ns=2.5, power_mw=3),
    Band(name="infrared", wavelength_nm=850, delay_ns=40, pulse_fwhm_ns=3, power_mw=2),
)


def camera(bands=BANDS, period=60.0, latency=7.3, **sensor) -> Instrument:
    about = {"rows": 6, "cols": 8, "code_bits": 7, "bin_width_ns": 0.5, **sensor}
    return Instrument(
        name="x", sensor=Sensor(**about), timing=Timing(period_ns=period, latency_ns=latency),
        bands=bands,
    )  # fmt: skip


def changed(number, **values):
    return tuple(
        msgspec.structs.replace(band, **values) if index == number else band
        for index, band in enumerate(BANDS)
    )


@pytest.fixture(scope="module")
def board(draw):
    return draw(camera(), depth=0.5, photons=5000, background=200)


def test_a_right_description_fits(board):
    # 7.3 ns of latency that the description does not know
    found = check_description(board, camera(latency=0.0), distance=0.5)
    assert found.problems == ()
    assert found.latency_ns == pytest.approx(7.3, abs=0.1)
    assert [pulse.band for pulse in found.pulses] == ["red", "green", "infrared"]
    for pulse, band in zip(found.pulses, BANDS, strict=True):
        at_ns = 7.3 + band.delay_ns + 2 * 0.5 / 0.299792458
        assert pulse.found_ns == pytest.approx(at_ns, abs=0.1)
        # a bin of .5 ns widens a pulse of 2 ns by 2 %
        assert pulse.found_fwhm_ns == pytest.approx(band.pulse_fwhm_ns, rel=0.06)
    assert found.direction == "as described"
    assert found.expected.sum() == pytest.approx(found.counts.sum(), rel=0.05)


def test_a_latency_just_below_0_is_not_found_as_a_whole_period(draw):
    later = tuple(msgspec.structs.replace(band, delay_ns=band.delay_ns + 0.1) for band in BANDS)
    counts = draw(camera(latency=0.0), photons=5000)
    found = check_description(counts, camera(bands=later, latency=0.0), distance=0.5)
    assert found.latency_ns == pytest.approx(-0.1, abs=0.05)


def test_a_single_shot_fits(draw):
    single = camera(period=None, latency=0.0)
    found = check_description(draw(single, depth=0.5, photons=5000), single, distance=0.5)
    assert found.problems == ()
    assert found.latency_ns == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (camera(changed(1, delay_ns=23.0)), "band 'green' stands -(2.9|3.0).* its delay_ns"),
        (camera(changed(2, pulse_fwhm_ns=9.0)), "band 'infrared' is 3.* its pulse_fwhm_ns"),
        (camera(direction="reverse"), 'check sensor.direction = "forward"'),
    ],
    ids=["delay", "width", "direction"],
)
def test_a_wrong_description_does_not(board, wrong, message):
    found = check_description(board, wrong, distance=0.5)
    text = "\n".join(found.problems)
    assert re.search(message, text), text


def test_photons_beyond_the_period_are_told(board):
    counts = board.copy()
    counts[..., 125] += 400
    found = check_description(counts, camera(), distance=0.5)
    assert "codes beyond the period of 60 ns" in found.problems[0]


def test_no_light_and_no_pulses(board):
    flat = np.full_like(board, 50)
    found = check_description(flat, camera(), distance=0.5)
    assert not found.pulses
    assert "no pulses" in found.problems[-1]
    with pytest.raises(HistogramError):
        check_description(np.zeros_like(board), camera(), distance=0.5)
