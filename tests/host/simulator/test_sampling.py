# SPDX-License-Identifier: Apache-2.0
"""Both samplers against p(code) and against each other."""

import numpy as np
import pytest
from scipy import stats

from hueflight import Instrument
from hueflight.errors import SceneError
from hueflight.simulator import (
    SimulationSettings,
    code_probabilities,
    expected_rates,
    pixels,
    scene,
    simulate_codes,
    simulate_histogram,
)

# one pixel of a real instrument: uneven bins, delay, dark counts, ambient light
REAL = SimulationSettings(hot_share=0, dead_share=0, delay_skew_ns=0.7)

# 35.0 m: a pulse across the end of the period and the partial code 499; as bright as at 1 m
WRAPPED = REAL.replace(white_detections=0.35 * 35**2, ambient=0.02 / 35**2)


def by_frames(view, instrument, *, frames, settings, seed):
    """Histogram of one pixel, counted from its frames."""
    counts = np.zeros(instrument.sensor.codes, dtype=np.int64)
    for block in simulate_codes(
        view, instrument, frames=frames, settings=settings, seed=seed, block_frames=1 << 20
    ):
        counts += np.bincount(block.ravel(), minlength=counts.size)
    return counts


def at_once(view, instrument, *, frames, settings, seed):
    histogram = simulate_histogram(view, instrument, frames=frames, settings=settings, seed=seed)
    return histogram[0, 0].astype(np.int64)


@pytest.mark.parametrize("sampler", [by_frames, at_once])
@pytest.mark.parametrize("pile_up", [True, False])
@pytest.mark.parametrize(("distance", "settings"), [(1.0, REAL), (35.0, WRAPPED)])
def test_ten_million_photons_follow_the_analytic_probabilities(
    full_rate_pixel, goodness_of_fit, sampler, pile_up, distance, settings
):
    # false alarm rate 1e-4 for each of the eight, seeded
    settings = settings.replace(pile_up=pile_up)
    view = scene("plane", full_rate_pixel, distance=distance)
    rates = expected_rates(view, full_rate_pixel, settings)
    frames = int(1.01e7 / rates.occupancy()[0, 0])
    counts = sampler(view, full_rate_pixel, frames=frames, settings=settings, seed=11)
    assert counts[1:].sum() >= 1e7
    assert counts.sum() == frames
    probabilities = code_probabilities(rates)[0, 0]
    assert goodness_of_fit(counts, probabilities) > 1e-4
    if distance > 1:  # there is light in the partial bin, in its share of a full one's width
        assert counts[499] > 10_000
        assert counts[499] / counts[498] == pytest.approx(0.284 / 0.642, rel=0.2)


def test_the_chi_square_sees_pile_up_of_one_period(full_rate_pixel, goodness_of_fit):
    # bright: 95 % hits, 1.8 % more early than late light; the wrong model must fail
    settings = REAL.replace(white_detections=3.0)
    view = scene("plane", full_rate_pixel)
    counts = at_once(view, full_rate_pixel, frames=30_000_000, settings=settings, seed=12)
    with_pile_up = expected_rates(view, full_rate_pixel, settings)
    without = expected_rates(view, full_rate_pixel, settings.replace(pile_up=False))
    assert goodness_of_fit(counts, code_probabilities(with_pile_up)[0, 0]) > 1e-4
    assert goodness_of_fit(counts, code_probabilities(without)[0, 0]) < 1e-12


def test_the_two_samplers_agree(paper, resized):
    # two-sample chi-square, pixel by pixel and over all; false alarm rate 1e-3 together, seeded
    instrument = resized(paper, 6, 5)
    view = scene("fig1", instrument)
    settings = SimulationSettings(white_detections=1.0, seed=5)
    frames = 40_000
    blocks = simulate_codes(view, instrument, frames=frames, settings=settings, seed=3)
    counted = np.zeros(instrument.histogram_shape, dtype=np.int64)
    for block in blocks:
        for code_map in block:
            counted[np.arange(6)[:, None], np.arange(5), code_map] += 1
    drawn = simulate_histogram(view, instrument, frames=frames, settings=settings, seed=3)
    p_values = []
    for a, b in zip(counted.reshape(30, -1), drawn.reshape(30, -1).astype(np.int64), strict=True):
        seen = a + b >= 20
        table = np.array([np.append(c[seen], c[~seen].sum()) for c in (a, b)])
        table = table[:, table.sum(axis=0) > 0]
        p_values.append(stats.chi2_contingency(table).pvalue if table.shape[1] > 1 else 1.0)
    assert min(p_values) > 1e-3 / 30
    assert stats.kstest([p for p in p_values if p < 1], "uniform").pvalue > 1e-3


def test_seeds_repeat_and_differ(paper, resized):
    instrument = resized(paper, 4, 4)
    view = scene("plane", instrument)

    def histogram(seed):
        return simulate_histogram(view, instrument, frames=5000, seed=seed)

    def codes(seed, **options):
        blocks = simulate_codes(view, instrument, frames=300, seed=seed, **options)
        return np.concatenate(list(blocks))

    np.testing.assert_array_equal(histogram(1), histogram(1))
    assert (histogram(1) != histogram(2)).any()
    np.testing.assert_array_equal(codes(1), codes(1))
    assert (codes(1) != codes(2)).any()
    assert (codes((1, 0)) != codes((1, 1))).any()
    assert codes(1).shape == (300, 4, 4)
    assert codes(1, rows=slice(1, 3)).shape == (300, 2, 4)


def test_frames_come_in_blocks(one_pixel):
    view = scene("plane", one_pixel)
    blocks = list(simulate_codes(view, one_pixel, frames=10, block_frames=4))
    assert [block.shape for block in blocks] == [(4, 1, 1), (4, 1, 1), (2, 1, 1)]
    assert all(block.dtype == np.uint16 for block in blocks)


def test_counters_are_wide_enough(one_pixel):
    view = scene("empty", one_pixel)
    settings = SimulationSettings.ideal()
    for frames, dtype in ((65_535, np.uint16), (65_536, np.uint32)):
        histogram = simulate_histogram(view, one_pixel, frames=frames, settings=settings)
        assert histogram.dtype == dtype
        assert histogram[0, 0, 0] == frames  # nothing there, every exposure empty


def test_dead_pixels_never_and_hot_pixels_always_fire(paper, resized, goodness_of_fit):
    instrument = resized(paper, 20, 20)
    settings = SimulationSettings(hot_share=0.05, dead_share=0.03, seed=9)
    marks = pixels(instrument, settings)
    assert marks.hot.sum() == 20
    assert marks.dead.sum() == 12
    histogram = simulate_histogram(
        scene("plane", instrument), instrument, frames=20_000, settings=settings
    )
    assert (histogram[marks.dead, 0] == 20_000).all()
    assert (histogram[marks.hot, 0] == 0).all()
    healthy = ~(marks.hot | marks.dead)
    assert (histogram[healthy, 0] > 0).all()
    # a hot pixel's codes decay from the opening of the exposure: p(t) ∝ exp(−rate·t), whatever
    # else there is (false alarm rate 1e-4 over 20 pixels, seeded)
    bins = expected_rates(scene("plane", instrument), instrument, settings).bins
    for counts, rate_hz in zip(
        histogram[marks.hot].astype(np.int64), marks.dark_rate_hz[marks.hot], strict=True
    ):
        decay = np.exp(-rate_hz * 1e-9 * bins.edges_ns)
        expected = np.zeros(512)
        expected[bins.codes] = -np.diff(decay) / (1 - decay[-1])
        assert goodness_of_fit(counts, expected) > 1e-4 / 20


def test_a_scanned_sensor_repeats_its_pixels():
    instrument = Instrument.load("line1024")
    marks = pixels(instrument, SimulationSettings())
    assert marks.hot.shape == (128, 1024)
    for name in ("delay_ns", "dark_rate_hz", "hot", "dead"):
        maps = getattr(marks, name).reshape(16, 8, 1024)
        np.testing.assert_array_equal(maps, np.broadcast_to(maps[0], maps.shape))


def test_bad_frames_and_sensors_are_named(paper, resized, one_pixel):
    view = scene("plane", one_pixel)
    with pytest.raises(SceneError, match="frames = 0"):
        simulate_histogram(view, one_pixel, frames=0)
    with pytest.raises(SceneError, match="frames = -3"):
        simulate_codes(view, one_pixel, frames=-3)
    with pytest.raises(SceneError, match="seed = -1"):
        simulate_codes(view, one_pixel, frames=3, seed=-1)
    with pytest.raises(SceneError, match=r"laid out for .*\(9, 1, 1\).*lay it out for"):
        simulate_histogram(view, paper, frames=10)
    no_empty = resized(paper, 1, 1, code_zero="bin")
    with pytest.raises(SceneError, match="no code for an empty exposure"):
        simulate_codes(view, no_empty, frames=10)
    # its histogram just counts fewer
    histogram = simulate_histogram(view, no_empty, frames=10_000, settings=REAL)
    assert 0 < histogram.sum() < 10_000
