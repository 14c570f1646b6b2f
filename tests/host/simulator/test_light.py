# SPDX-License-Identifier: Apache-2.0
"""The light budget: distance, angle, power, and what the settings change."""

from math import pi

import numpy as np
import pytest

from hueflight import Instrument
from hueflight.errors import InstrumentError, SceneError
from hueflight.simulator import (
    SimulationSettings,
    expected_rates,
    pixels,
    radiometric_detections,
    scene,
    simulate_histogram,
    time_bins,
    white_photons,
)

IDEAL = SimulationSettings.ideal()


@pytest.mark.parametrize("preset", Instrument.presets())
def test_the_one_scale_holds_for_every_preset(preset, resized):
    # by default 0.35 LED photons per exposure from white at 1 m, whatever the exposure
    instrument = resized(Instrument.load(preset), 1, 1)
    rates = expected_rates(scene("plane", instrument), instrument, IDEAL)
    assert rates.detections() == pytest.approx(0.35)
    assert rates.occupancy() == pytest.approx(1 - np.exp(-0.35))


def test_light_falls_with_the_square_of_distance(paper):
    def photons(distance):
        return expected_rates(scene("plane", paper, distance=distance), paper, IDEAL).photons

    at_1m = photons(1.0)
    for distance in (0.4, 0.5, 2.0, 7.0):
        np.testing.assert_allclose(photons(distance) * distance**2, at_1m, rtol=1e-12)


def test_light_falls_towards_the_corners_as_eight_cosines(paper):
    # to the wall at depth z: LED cosine · incidence · 1/range² = cos⁴/z², back to the pixel: cos⁴
    detections = expected_rates(scene("plane", paper), paper, IDEAL).detections()
    np.testing.assert_allclose(detections, 0.35 * paper.ray_cosine() ** 8)


def test_delay_is_the_way_there_and_back_along_the_ray(one_pixel, paper):
    at_150m = expected_rates(scene("plane", one_pixel, distance=150.0), one_pixel, IDEAL)
    assert at_150m.delay_ns == pytest.approx(300 / 0.299792458)
    corner = expected_rates(scene("plane", paper), paper, IDEAL).delay_ns
    np.testing.assert_allclose(corner, 2 / 0.299792458 / paper.ray_cosine())


def test_photons_over_those_of_the_reference_are_the_true_reflectance(paper):
    # what the paper's α does: a white plane at 0.40 m, then range corrected
    view = scene("fig1", paper)
    truth = view.truth(paper)
    reference = expected_rates(scene("plane", paper, distance=0.40), paper, IDEAL)
    rates = expected_rates(view, paper, IDEAL)
    ratio = rates.photons / reference.photons * (truth.depth / 0.40) ** 2
    lit = truth.lit
    np.testing.assert_allclose(ratio[:, lit], (truth.reflectance * truth.shading)[:, lit])
    shadow = (view.light < 1).all(axis=0)
    np.testing.assert_allclose(ratio[:, shadow], 0.03 * truth.reflectance[:, shadow])


def test_bands_share_light_by_power_and_detection(paper):
    # photons per joule ∝ wavelength; compare two bands by hand (narrow lines, so roughly)
    white = white_photons(paper, IDEAL)
    nm = list(paper.wavelengths_nm)
    red, green = nm.index(659), nm.index(525)
    pdp = np.interp([659, 525], [500, 550, 650, 700], [0.32, 0.33, 0.24, 0.19])
    by_hand = (3.88 * 659 * pdp[0]) / (1.44 * 525 * pdp[1])
    assert white[red] / white[green] == pytest.approx(by_hand, rel=0.03)
    # the green gap: amber is the weakest by far
    assert np.argmin(white) == nm.index(597)


def test_radiometric_estimate_by_hand(paper):
    # one band at 550 nm, by the textbook: P λ/(hc) photons/s, 1/π W/m²/sr² each way, π/(4N²) sr
    band = paper.bands[4]
    only = type(band)(name="g", wavelength_nm=550, emission_fwhm_nm=4.5, power_mw=1.0)
    photons_per_s = 1e-3 / (6.62607015e-34 * 299792458 / 550e-9)
    on_pixel = photons_per_s / pi**2 * 18.4e-6 * 9.2e-6 * 0.13 * pi / (4 * 1.4**2)
    by_hand = on_pixel * 0.9 * 0.33 * 1e-3
    assert radiometric_detections(paper.replace(bands=(only,))) == pytest.approx(by_hand, rel=0.01)
    # the default light is preset `paper` at f/8
    assert 1.4 * np.sqrt(radiometric_detections(paper) / 0.35) == pytest.approx(8.2, abs=0.1)
    with pytest.raises(InstrumentError, match="needs a lens"):
        radiometric_detections(paper.replace(lens=None))


def test_drive_dims_leds_and_nothing_else(one_pixel):
    view = scene("plane", one_pixel)
    settings = SimulationSettings(hot_share=0, dead_share=0)
    full = expected_rates(view, one_pixel, settings)
    only_green = tuple(0.5 * (band.name == "green") for band in one_pixel.bands)
    one = expected_rates(view, one_pixel, settings.replace(drive=only_green))
    np.testing.assert_allclose(one.photons[4], 0.5 * full.photons[4])
    assert one.photons.sum() == one.photons[4].sum()
    np.testing.assert_array_equal(one.background, full.background)
    off = expected_rates(view, one_pixel, settings.replace(drive=0.0))
    assert not off.photons.any()


def test_background_is_ambient_light_plus_dark_counts(one_pixel):
    view = scene("plane", one_pixel)
    ambient = expected_rates(view, one_pixel, IDEAL.replace(ambient=0.1))
    assert ambient.background * 3125 == pytest.approx(0.035)
    grey = scene("plane", one_pixel, surface=0.2)
    assert expected_rates(grey, one_pixel, IDEAL.replace(ambient=0.1)).background == pytest.approx(
        0.2 * ambient.background
    )
    # 25 counts per second in 1 ms
    dark = expected_rates(view, one_pixel, IDEAL.replace(dark_counts=1.0))
    assert dark.background * 3125 == pytest.approx(0.025)


def test_empty_scene_has_dark_counts_only(paper):
    rates = expected_rates(scene("empty", paper), paper, SimulationSettings())
    assert not rates.photons.any()
    assert np.median(rates.detections()) == pytest.approx(0.025, rel=0.05)


def test_pulses_have_the_widths_of_table_1(resized):
    # one LED at a time on 55 ps bins, 10⁷ photons each; the counts of the bins at half maximum
    # have 0.9 % noise, so edges move by ~20 ps: tolerance 0.1 ns is five times that
    instrument = resized(Instrument.load("fine"), 1, 1)
    view = scene("plane", instrument)
    table_1 = {659: 11.8, 632: 13.9, 623: 11.9, 597: 13.0, 525: 11.2, 498: 9.3, 469: 11.3,
               445: 7.5, 418: 7.1}  # fmt: skip
    for index, band in enumerate(instrument.bands):
        drive = tuple(float(index == other) for other in range(9))
        share = white_photons(instrument, IDEAL)[index]
        settings = IDEAL.replace(drive=drive, white_detections=0.35 * 0.01 / share)
        counts = simulate_histogram(
            view, instrument, frames=1_000_000_000, settings=settings, seed=index
        )[0, 0, 1:]
        assert counts.sum() == pytest.approx(1e7, rel=0.02)
        smooth = np.convolve(counts, np.ones(9) / 9, mode="same")
        above = np.flatnonzero(smooth > smooth.max() / 2)
        width = (above[-1] - above[0] + 1) * 0.055
        assert width == pytest.approx(table_1[int(band.wavelength_nm)], abs=0.15)


# -- imperfections ----------------------------------------------------------------------------


def test_ideal_pixels_are_alike_and_bins_nominal(paper):
    marks = pixels(paper, IDEAL)
    for values in (marks.hot, marks.dead, marks.delay_ns, marks.dark_rate_hz):
        assert not values.any()
    np.testing.assert_array_equal(time_bins(paper, IDEAL).edges_ns, paper.time_bins().edges_ns)


def test_pixels_spread_as_asked(paper):
    settings = SimulationSettings(delay_skew_ns=2.0, delay_spread_ns=0.3, dark_spread=0.4)
    marks = pixels(paper, settings)
    assert marks.hot.sum() == round(0.01 * 24576)
    assert marks.dead.sum() == pytest.approx(0.002 * 24576, abs=1)
    assert not (marks.hot & marks.dead).any()
    own = marks.delay_ns - np.linspace(0, 2.0, 128)
    assert own.std() == pytest.approx(0.3, rel=0.02)
    healthy = marks.dark_rate_hz[~marks.hot]
    assert np.median(healthy) == pytest.approx(25, rel=0.02)
    assert np.log(healthy).std() == pytest.approx(0.4, rel=0.02)
    assert marks.dark_rate_hz[marks.hot].min() >= 1e6


def test_switching_one_imperfection_off_leaves_the_others(paper):
    all_on = pixels(paper, SimulationSettings())
    no_hot = pixels(paper, SimulationSettings(hot_share=0))
    np.testing.assert_array_equal(all_on.delay_ns, no_hot.delay_ns)
    np.testing.assert_array_equal(
        all_on.dark_rate_hz[~all_on.hot], no_hot.dark_rate_hz[~all_on.hot]
    )
    other = pixels(paper, SimulationSettings(seed=1))
    assert (other.hot != all_on.hot).any()


@pytest.mark.parametrize("preset", ["paper", "fine"])
def test_bins_vary_as_asked_and_close_the_period(preset):
    instrument = Instrument.load(preset)
    settings = SimulationSettings(dnl_lsb=0.1, inl_lsb=0.0)
    bins, nominal = time_bins(instrument, settings), instrument.time_bins()
    width = instrument.sensor.bin_width_ns
    np.testing.assert_array_equal(bins.codes, nominal.codes)
    assert bins.edges_ns[0] == 0
    assert bins.edges_ns[-1] == pytest.approx(320, abs=1e-9)
    assert np.std(bins.widths_ns / width) == pytest.approx(0.1, rel=0.15)
    # the partial bin keeps its width: first in time in reverse mode, last in forward mode
    partial = 0 if instrument.sensor.direction == "reverse" else -1
    assert bins.widths_ns[partial] == pytest.approx(nominal.widths_ns[partial])
    arched = time_bins(instrument, SimulationSettings(dnl_lsb=0.0, inl_lsb=0.8))
    deviation = (arched.edges_ns - nominal.edges_ns) / width
    assert np.abs(deviation).max() == pytest.approx(0.8, rel=1e-3)
    assert np.abs(deviation[[0, 1, -2, -1]]).max() < 0.02


def test_flat_light_measures_the_bin_widths(one_pixel):
    # the code-density test: counts ∝ widths; false alarm rate 1e-5 over 499 bins, seeded
    settings = SimulationSettings.ideal(drive=0.0, ambient=1.0, dnl_lsb=0.1, inl_lsb=0.5)
    histogram = simulate_histogram(
        scene("plane", one_pixel), one_pixel, frames=100_000_000, settings=settings
    )
    bins = time_bins(one_pixel, settings)
    counts = bins.in_time_order(histogram)[0, 0].astype(float)
    expected = counts.sum() * bins.widths_ns / 320
    assert np.abs((counts - expected) / np.sqrt(expected)).max() < 5.7


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ambient": -1}, r"settings\.ambient = -1"),
        ({"white_detections": float("nan")}, "white_detections = nan"),
        ({"hot_share": 0.7, "dead_share": 0.5}, "together exceed 1"),
        ({"drive": (1.0, -2.0)}, r"drive = \(1\.0, -2\.0\)"),
        ({"dnl_lsb": 0.5}, "some codes would have no width"),
        ({"delay_skew_ns": float("inf")}, "delay_skew_ns = inf"),
    ],
)
def test_bad_settings_are_named(changes, message):
    with pytest.raises(SceneError, match=message):
        SimulationSettings(**changes)


def test_drive_of_other_bands_is_named(one_pixel):
    with pytest.raises(SceneError, match=r"drive has 2 entries but .* has 9 bands"):
        expected_rates(scene("plane", one_pixel), one_pixel, IDEAL.replace(drive=(1.0, 1.0)))
