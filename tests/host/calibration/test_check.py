# SPDX-License-Identifier: Apache-2.0
"""A new capture of the reference tells what has changed since the calibration."""

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.calibration import check_calibration
from hueflight.errors import CalibrationError, HistogramError

PHOTONS = 2000


@pytest.fixture(scope="module")
def instrument(small):
    return small("paper", rows=20, cols=24)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument, photons=PHOTONS), instrument, distance=0.5)


def with_band(instrument, index, **changes):
    bands = list(instrument.bands)
    bands[index] = msgspec.structs.replace(bands[index], **changes)
    return instrument.replace(bands=tuple(bands))


def test_nothing_has_changed(calibration, instrument, draw):
    findings, scores = [], []
    for seed in range(1, 9):
        check = check_calibration(calibration, draw(instrument, photons=PHOTONS, seed=seed))
        findings += check.findings
        scores.append(check.delay_ns / check.delay_std_ns)
    # 8 × 27 values beyond four deviations: a false alarm in 70 runs
    assert not findings
    # the noise of the calibration is common to all eight
    assert 0.5 < np.std(scores) < 1.5
    assert 0.85 < np.nanstd(check.pixel_z) < 1.15
    assert 0.85 < np.nanstd(check.brightness_z) < 1.15
    assert check.as_dict()["holds"]


def test_one_led_arrives_later(calibration, instrument, draw):
    delay = instrument.bands[4].delay_ns
    moved = with_band(instrument, 4, delay_ns=delay + 0.3)
    check = check_calibration(calibration, draw(moved, photons=PHOTONS, seed=3))
    apart = check.delay_ns[4] - np.delete(check.delay_ns, 4).mean()
    assert apart == pytest.approx(0.3, abs=4 * check.delay_std_ns[4])
    assert any(f"band {instrument.bands[4].name!r} arrives" in text for text in check.findings)
    assert not check.holds


def test_suspects_have_the_terms_of_the_check_of_a_picture(calibration, instrument, draw):
    delay = instrument.bands[4].delay_ns
    moved = with_band(instrument, 4, delay_ns=delay + 0.3)
    histogram = draw(moved, photons=PHOTONS, seed=3)
    of_target = {one.name: one for one in check_calibration(calibration, histogram).suspects}
    image = hf.reconstruct(histogram, calibration)
    of_picture = hf.check_image(histogram, calibration, image)["delay"]
    delays = of_target["delay"]
    assert delays.found
    assert of_picture.found
    assert not of_target["width"].found
    assert (delays.labels, delays.unit) == (of_picture.labels, of_picture.unit)
    assert sum(delays.sizes) == pytest.approx(0, abs=1e-6)
    apart = np.subtract(delays.sizes, of_picture.sizes)
    assert (np.abs(apart) < 4 * np.hypot(delays.deviations, of_picture.deviations)).all()
    assert delays.sizes[4] == pytest.approx(300 * 8 / 9, abs=4 * delays.deviations[4])


def test_one_led_is_dimmer_and_its_pulse_wider(calibration, instrument, draw):
    wide = with_band(instrument, 7, pulse_fwhm_ns=1.1 * instrument.bands[7].pulse_fwhm_ns)
    dim = np.ones(9)
    dim[1] = 0.8
    share = (instrument.band_brightness() * dim).sum() / instrument.band_brightness().sum()
    counts = draw(wide, photons=PHOTONS * share, reflectance=dim, seed=3)
    check = check_calibration(calibration, counts)
    assert check.brightness[1] == pytest.approx(0.8, abs=4 * check.brightness_std[1])
    assert check.brightness[5] == pytest.approx(1.0, abs=4 * check.brightness_std[5])
    assert check.width[7] == pytest.approx(1.1, abs=0.015)
    assert check.width[[0, 3, 5]] == pytest.approx(1.0, abs=0.03)
    names = [band.name for band in instrument.bands]
    assert any(f"{names[1]!r} is 2" in text and "% dimmer" in text for text in check.findings)
    assert any(f"{names[7]!r} is" in text and "% wider" in text for text in check.findings)


def test_target_has_moved(calibration, instrument, draw):
    counts = draw(instrument, depth=0.56, photons=PHOTONS * (0.5 / 0.56) ** 2, seed=3)
    check = check_calibration(calibration, counts)
    # 6 cm: 0.400 ns, where the calibration is good to 0.006
    assert check.common_delay_ns == pytest.approx(0.4, abs=0.02)
    assert any("cm farther than stated" in text and "later" in text for text in check.findings)
    told = check_calibration(calibration, counts, distance=0.56)
    assert told.holds
    assert abs(told.common_delay_ns) < 0.02


def test_pixels_become_dead_and_hot(calibration, instrument, draw):
    counts = draw(instrument, photons=PHOTONS, seed=3)
    counts[3, 4, 1:] = 0
    counts[5, 6, 1:] = np.random.default_rng(1).poisson(40, counts.shape[-1] - 1)
    check = check_calibration(calibration, counts)
    assert np.argwhere(check.new_dead).tolist() == [[3, 4]]
    assert np.argwhere(check.new_hot).tolist() == [[5, 6]]
    assert "1 pixels have become dead" in check.findings


def test_pixel_with_another_delay(calibration, instrument, draw):
    counts = draw(instrument, photons=PHOTONS, seed=3)
    later = draw(instrument, depth=0.65, photons=PHOTONS, seed=4)
    counts[:4, :4] = later[:4, :4]
    check = check_calibration(calibration, counts)
    assert (check.pixel_z[:4, :4] > 4).all()
    assert (np.abs(check.pixel_z[5:, 5:]) < 4.5).all()
    assert any("16 of 480 pixels have another delay" in text for text in check.findings)


def test_a_scene_is_no_reference(calibration, instrument, draw):
    counts = draw(instrument, photons=PHOTONS, seed=3)
    counts[:, 12:] = draw(instrument, depth=0.7, photons=PHOTONS / 2, seed=4)[:, 12:]
    findings = check_calibration(calibration, counts).findings
    assert any("does not show the flat target" in text for text in findings)


def test_captures_that_cannot_be_checked(calibration, instrument, draw):
    dark = np.zeros(instrument.histogram_shape, np.uint32)
    dark[..., 0] = 1000
    with pytest.raises(CalibrationError, match="no light"):
        check_calibration(calibration, dark)
    with pytest.raises(HistogramError):
        check_calibration(calibration, dark[:4])
