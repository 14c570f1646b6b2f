# SPDX-License-Identifier: Apache-2.0
import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import CalibrationError, HistogramError
from hueflight.reconstruction.bounds import expected_shares


def one_led(draw, instrument, **options):
    bands = range(len(instrument.bands))
    return np.stack(
        [draw(instrument, reflectance=np.arange(len(bands)) == k, seed=k, **options) for k in bands]
    )


def test_templates_from_one_led_captures_match_the_pulses(small, draw):
    instrument = small(rows=16, cols=16)
    reference = draw(instrument, photons=20_000, background=500)
    bands = one_led(draw, instrument, photons=20_000, background=500)
    calibration = hf.calibrate(reference, instrument, distance=0.5, bands=bands)
    shares = calibration.templates.shares(calibration.bins.edges_ns)
    truth, _, _ = expected_shares(instrument, 0.5)
    # 5·10⁶ photons a band: a bin at the peak is known to .2 %, five deviations are 1 %
    assert np.abs(shares - truth).max(axis=1) == pytest.approx(0, abs=0.01 * truth.max())
    # the mean of a pulse is known to σ/√N = 5 ns/√5·10⁶ = 2 ps
    center = (shares - truth) @ calibration.bins.centers_ns
    assert np.abs(center).max() < 0.025


@pytest.mark.parametrize("tail_ns", [0.0, 3.0, 6.0])
def test_templates_parted_from_the_whole_train_match_too(small, draw, tail_ns):
    instrument = small(rows=16, cols=16)
    bands = tuple(msgspec.structs.replace(b, pulse_tail_ns=tail_ns) for b in instrument.bands)
    instrument = instrument.replace(bands=bands)
    reference = draw(instrument, photons=180_000, background=1000)
    calibration = hf.calibrate(reference, instrument, distance=0.5)
    shares = calibration.templates.shares(calibration.bins.edges_ns)
    truth, _, _ = expected_shares(instrument, 0.5)
    assert np.abs(shares - truth).max() < 0.015 * truth.max()


@pytest.mark.parametrize("preset", ["paper", "fine"])
def test_brightness_is_photons_per_frame_of_each_band(small, draw, preset):
    instrument = small(preset, rows=4, cols=4)
    reference = draw(instrument, photons=40_000, background=4000, frames=10**8)
    known = np.linspace(0.5, 1.0, 9)
    calibration = hf.calibrate(reference, instrument, distance=0.5, reflectance=known)
    white = instrument.band_brightness()
    expected = 40_000 * white / white.sum() / 10**8 / known
    # the faintest band has 16 · 1800 photons beside background: 5 deviations are 4 %
    assert calibration.brightness == pytest.approx(expected, rel=0.04)


def test_pixel_delays_are_found_and_do_not_blur_the_templates(small, draw):
    instrument = small(rows=12, cols=12)
    sharp = hf.calibrate(draw(instrument, photons=50_000), instrument, distance=0.5)
    delay_ns = np.linspace(-2, 2, 144).reshape(12, 12)
    skewed = np.empty(instrument.histogram_shape, np.uint32)
    one = small(rows=1, cols=1)
    for index in np.ndindex(12, 12):
        seen_at = 0.5 + delay_ns[index] * 0.299792458 / 2
        skewed[index] = draw(one, depth=seen_at, photons=50_000, seed=hash(index) % 9999)[0, 0]
    calibration = hf.calibrate(skewed, instrument, distance=0.5)
    found = calibration.pixel_delay_ns - np.median(calibration.pixel_delay_ns)
    # the bound at 50 000 photons is 19 ps; five deviations and the rounding of the phase
    assert np.abs(found - delay_ns).max() < 0.15
    width = [
        np.sqrt(c.templates.density(np.linspace(0, 320, 3201)).max(axis=1))
        for c in (sharp, calibration)
    ]
    assert width[1] == pytest.approx(width[0], rel=0.02)


def test_code_density_measures_bin_widths(small, draw):
    instrument = small()
    bins = instrument.time_bins()
    widths = bins.widths_ns * np.random.default_rng(0).normal(1, 0.1, bins.count)
    flat = np.zeros(instrument.histogram_shape, np.uint64)
    flat[..., bins.codes] = np.random.default_rng(1).poisson(
        widths / widths.sum() * 5e6, (8, 8, bins.count)
    )
    calibration = hf.calibrate(draw(instrument), instrument, distance=0.5, flat=flat)
    expected = widths / widths.sum() * 320
    # 640 000 photons a bin: .13 %; six deviations
    assert calibration.bins.widths_ns == pytest.approx(expected, rel=0.008)
    assert calibration.bins.edges_ns[-1] == pytest.approx(320)


@pytest.mark.filterwarnings("error")
def test_a_pixel_without_frames_is_dead_and_changes_nothing_else(small, draw):
    instrument = small(rows=8, cols=8)
    reference = draw(instrument, photons=5000, frames=10**6)
    whole = hf.calibrate(reference, instrument, distance=0.5)
    reference[2, 3] = 0
    masked = hf.calibrate(reference, instrument, distance=0.5)
    assert np.argwhere(masked.dead).tolist() == [[2, 3]]
    assert np.isnan(masked.flat_field[2, 3])
    # the mean of 64 pixels of 5000 photons, without one of them
    assert masked.brightness == pytest.approx(whole.brightness, rel=0.01)


def test_hot_and_dead_pixels_are_found_and_only_they(small, draw):
    instrument = small(rows=16, cols=16)
    reference = draw(instrument, photons=400, background=40)
    bins = instrument.time_bins()
    reference[2, 3, bins.codes] = 200  # fires whatever the LEDs do
    reference[2, 3, 0] = 0
    reference[5, 6, 1:] = 0
    reference[5, 6, 0] = 1_000_000
    calibration = hf.calibrate(reference, instrument, distance=0.5)
    assert np.argwhere(calibration.hot).tolist() == [[2, 3]]
    assert np.argwhere(calibration.dead).tolist() == [[5, 6]]


def test_a_dark_capture_shows_pixels_that_fire_on_their_own(small, draw):
    instrument = small(rows=16, cols=16)
    dark = np.zeros(instrument.histogram_shape, np.uint32)
    dark[..., 0] = 1_000_000
    dark[..., 100] = 1
    dark[7, 7, 1:400] = 3
    calibration = hf.calibrate(draw(instrument), instrument, distance=0.5, dark=dark)
    assert np.argwhere(calibration.hot).tolist() == [[7, 7]]


def test_provenance_tells_when_by_what_and_from_what(small, draw):
    instrument = small()
    calibration = hf.calibrate(draw(instrument), instrument, distance=0.5, reflectance=0.9)
    provenance = calibration.provenance
    assert provenance["created"].endswith("+00:00")
    assert provenance["software"].startswith("hueflight ")
    assert provenance["reference_frames"] == 1_000_000
    assert provenance["reflectance"] == [0.9] * 9


def test_use_with_another_instrument_says_what_differs(small, draw):
    instrument = small()
    calibration = hf.calibrate(draw(instrument), instrument, distance=0.5)
    other = small(bin_width_ns=0.65)
    with pytest.raises(CalibrationError, match=r"sensor\.bin_width_ns: 0\.642 != 0\.65"):
        calibration.require(other)
    calibration.require(instrument.replace(name="the same under another name"))


class TestBadCaptures:
    def test_no_light(self, small):
        instrument = small()
        reference = np.zeros(instrument.histogram_shape, np.uint32)
        reference[..., 0] = 100
        with pytest.raises(CalibrationError, match="reference has no light"):
            hf.calibrate(reference, instrument, distance=0.5)

    def test_light_without_pulses(self, small, draw):
        instrument = small()
        reference = draw(instrument, reflectance=0.0, background=3000)
        with pytest.raises(CalibrationError, match="no pulses in it"):
            hf.calibrate(reference, instrument, distance=0.5)

    def test_one_led_dark(self, small, draw):
        instrument = small()
        lit = np.arange(9) != 4
        with pytest.raises(CalibrationError, match="'green'"):
            hf.calibrate(draw(instrument, reflectance=lit), instrument, distance=0.5)

    @pytest.mark.parametrize("distance", [-1.0, np.nan, np.inf])
    def test_distance(self, small, draw, distance):
        instrument = small()
        with pytest.raises(CalibrationError, match="distance = "):
            hf.calibrate(draw(instrument), instrument, distance=distance)

    @pytest.mark.parametrize(
        ("reflectance", "message"), [(0.0, "above 0"), ([1, 2], "shape"), (np.nan, "above 0")]
    )
    def test_reflectance(self, small, draw, reflectance, message):
        instrument = small()
        with pytest.raises(CalibrationError, match=message):
            hf.calibrate(draw(instrument), instrument, distance=0.5, reflectance=reflectance)

    def test_bands_in_another_order(self, small, draw):
        instrument = small()
        bands = one_led(draw, instrument, photons=5000)
        with pytest.raises(CalibrationError, match="'deep red' alone has its light elsewhere"):
            hf.calibrate(draw(instrument), instrument, distance=0.5, bands=bands[::-1])

    def test_bands_of_the_wrong_shape(self, small, draw):
        instrument = small()
        with pytest.raises(CalibrationError, match=r"needs \(band, row, col, code\)"):
            hf.calibrate(draw(instrument), instrument, distance=0.5, bands=np.ones((3, 8, 8, 512)))

    def test_flat_too_short(self, small, draw):
        instrument = small()
        flat = np.ones(instrument.histogram_shape, np.uint8)
        with pytest.raises(CalibrationError, match="capture longer"):
            hf.calibrate(draw(instrument), instrument, distance=0.5, flat=flat)

    def test_reference_of_another_shape(self, small, draw):
        with pytest.raises(HistogramError, match="transpose"):
            hf.calibrate(draw(small(rows=4)).transpose(2, 0, 1), small(rows=4), distance=0.5)


@pytest.mark.parametrize("repeats", [1, 60])
def test_a_pixel_lit_in_each_of_few_exposures_is_refused_in_words(small, draw, repeats):
    instrument = small(rows=12, cols=12)
    reference = draw(instrument, photons=40, frames=100)
    full = reference[3, 4].copy()
    full[0] = 0  # follows the pulses like any other, and was never empty
    reference[3, 4] = full
    with pytest.raises(CalibrationError, match=r"photon in every exposure.*Take more frames"):
        hf.calibrate(reference * repeats, instrument, distance=0.5)


def test_references_that_hold_next_to_nothing_are_refused_in_words(small, draw):
    instrument = small(rows=8, cols=8)
    one = draw(instrument, photons=0, frames=2000)
    one[3, 4, 100] = 1
    same = draw(instrument, photons=0, frames=2000)
    same[..., 100] = 500
    even = draw(instrument, photons=0, frames=20_000)
    even[..., 1:499] = 7
    for reference in (one, same, even):
        with pytest.raises(CalibrationError, match=r"check that LED|Check that the LEDs"):
            hf.calibrate(reference, instrument, distance=0.5)
    with pytest.raises(HistogramError):
        hf.calibrate(np.zeros_like(one), instrument, distance=0.5)
