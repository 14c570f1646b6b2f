# SPDX-License-Identifier: Apache-2.0
"""Against the table of limits that was computed for Gaussian pulses of the paper's Table 1."""

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import HueflightError
from hueflight.reconstruction.bounds import fisher_information


@pytest.fixture(scope="module")
def gaussian():
    """Pulses without tails, light weighted by power × detection probability alone."""
    instrument = hf.Instrument.load("paper")
    sensor = instrument.sensor
    probability = np.interp(
        instrument.wavelengths_nm, sensor.detection_wavelength_nm, sensor.detection_probability
    )
    bands = tuple(
        # band_brightness counts photons: power × wavelength
        msgspec.structs.replace(b, pulse_tail_ns=0.0, power_mw=b.power_mw * p / b.wavelength_nm)
        for b, p in zip(instrument.bands, probability, strict=True)
    )
    blind = msgspec.structs.replace(sensor, detection_wavelength_nm=(), detection_probability=())
    return instrument.replace(bands=bands, sensor=blind)


@pytest.mark.parametrize(
    ("photons", "background", "centimetres"),
    [
        (100, 0, 5.96),
        (100, 100, 8.07),
        (620, 0, 2.39),
        (1000, 0, 1.88),
        (1000, 1000, 2.55),
        (10_000, 0, 0.60),
        (10_000, 10_000, 0.81),
    ],
)
def test_depth_bound_of_a_white_target(gaussian, photons, background, centimetres):
    bound = hf.depth_bound(gaussian, photons=photons, background=background)
    assert 100 * bound == pytest.approx(centimetres, abs=0.011)


def test_bin_width_does_not_limit_this_system(gaussian):
    fine = msgspec.structs.replace(gaussian.sensor, bin_width_ns=0.0642, code_bits=13)
    narrow = hf.depth_bound(gaussian.replace(sensor=fine), photons=1000)
    wide = hf.depth_bound(gaussian, photons=1000)
    assert narrow < wide < 1.005 * narrow


def test_one_gaussian_pulse_has_the_textbook_bound():
    """σ/√N for the arrival time of a Gaussian pulse without background, bins ≪ σ."""
    instrument = hf.Instrument.load("fine")
    one = (msgspec.structs.replace(instrument.bands[0], pulse_tail_ns=0.0, pulse_fwhm_ns=10.0),)
    bound = hf.depth_bound(instrument.replace(bands=one), photons=400)
    sigma_ns = 10 / (2 * np.sqrt(2 * np.log(2)))
    assert bound == pytest.approx(0.299792458 / 2 * sigma_ns / 20, rel=1e-3)


def test_reflectance_bound_without_background_is_poisson(gaussian):
    """Away from the neighbours' feet a band's photons are simply counted."""
    bound = hf.reflectance_bound(gaussian, photons=10_000)
    brightness = gaussian.band_brightness()
    photons = 10_000 * brightness / brightness.sum()
    assert bound == pytest.approx(1 / np.sqrt(photons), rel=0.03)


def test_bound_from_a_calibration_is_the_instruments(small, draw):
    instrument = small(rows=16, cols=16)
    calibration = hf.calibrate(draw(instrument, photons=50_000), instrument, distance=0.5)
    for depth in (0.5, 0.73, 2.0):
        arguments = {"photons": 620, "background": 60, "depth": depth}
        assert hf.depth_bound(calibration, **arguments) == pytest.approx(
            hf.depth_bound(instrument, **arguments), rel=0.01
        )


def test_empty_bins_tell_nothing():
    fisher = fisher_information(
        np.array([[0.5, 0.5, 0.0]]), np.zeros((1, 3)), np.zeros(3), [10.0], 0.0
    )
    assert fisher[1, 1] == pytest.approx(0.1)


@pytest.mark.parametrize(
    "arguments",
    [
        {"photons": 0},
        {"photons": np.nan},
        {"photons": 10, "background": -1},
        {"photons": 10, "reflectance": np.zeros(9)},
        {"photons": 10, "reflectance": np.ones(3)},
        {"photons": 10, "reflectance": -np.ones(9)},
    ],
)
def test_senseless_numbers(gaussian, arguments):
    with pytest.raises(HueflightError):
        hf.depth_bound(gaussian, **arguments)
