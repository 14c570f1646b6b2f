# SPDX-License-Identifier: Apache-2.0
"""p(code) against closed forms and against a brute-force simulation of the photons themselves."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hueflight import Instrument
from hueflight.simulator import (
    SimulationSettings,
    code_probabilities,
    expected_rates,
    probability_tiles,
    scene,
    time_bins,
)
from hueflight.simulator.probabilities import PulseTable, first_photon_probabilities


def photon_by_photon(
    instrument: Instrument,
    photons_per_band: np.ndarray,
    delay_ns: float,
    background: float,
    *,
    periods: int,
    exposures: int,
    converter_edges_ns: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Counts per code of a sensor that watches every photon and keeps an exposure's first.

    Written from the physics, not from the code under test: Poisson numbers of photons, each with
    a random period, band, Gaussian jitter and exponential decay; a converter that the photon
    starts and the clock's next edge stops; codes from 1, each up to one of the converter's edges.
    """
    period_ns = instrument.timing.period_ns
    assert period_ns is not None
    rates = np.append(photons_per_band, background)
    numbers = rng.poisson(periods * rates.sum(), exposures)
    total = int(numbers.sum())
    source = rng.choice(rates.size, size=total, p=rates / rates.sum())
    arrival = rng.uniform(0, period_ns, total)
    for band in range(rates.size - 1):
        (pulse,) = instrument.pulses(band)
        mine = source == band
        jitter = rng.normal(0, pulse.sigma_ns, mine.sum())
        decay = rng.exponential(pulse.tail_ns, mine.sum()) if pulse.tail_ns else 0
        arrival[mine] = pulse.center_ns + delay_ns + jitter + decay
    # a train that never stops: what leaves one period's end enters the next one's start
    moment = rng.integers(0, periods, total) * period_ns + np.mod(arrival, period_ns)
    occupied = np.flatnonzero(numbers)
    first = np.minimum.reduceat(moment, np.concatenate([[0], np.cumsum(numbers)])[occupied])
    to_clock_edge = period_ns - np.mod(first, period_ns)
    codes = np.zeros(exposures, dtype=int)
    codes[: first.size] = 1 + np.searchsorted(converter_edges_ns, to_clock_edge)
    return np.bincount(codes, minlength=instrument.sensor.codes)


@pytest.mark.parametrize(("periods", "light"), [(1, 1.3), (4, 2.0), (168, 0.35)])
def test_brute_force_photons_follow_the_analytic_probabilities(
    paper, resized, goodness_of_fit, periods, light
):
    # false alarm rate 1e-4 each, seeded
    instrument = resized(paper, 1, 1, exposure_ms=periods * 320e-6)
    settings = SimulationSettings.ideal(ambient=0.1)
    # 35.0 m away, a pulse lies across the end of the period and the partial code 499
    for distance, dnl, seed in ((1.0, 0.0, 1), (35.0, 0.0, 2), (1.0, 0.1, 3)):
        # as bright at any distance
        same = settings.replace(
            white_detections=light * distance**2, ambient=0.1 / distance**2, dnl_lsb=dnl
        )
        rates = expected_rates(scene("plane", instrument, distance=distance), instrument, same)
        assert rates.periods == periods
        edges = np.append(0.642 * np.arange(1, 499), 320)
        if dnl:
            edges = 320 - time_bins(instrument, same).edges_ns[-2::-1]
            assert edges.size == 499
        counts = photon_by_photon(
            instrument,
            rates.photons[:, 0, 0],
            float(rates.delay_ns[0, 0]),
            float(rates.background[0, 0]),
            periods=periods,
            exposures=1_000_000,
            converter_edges_ns=edges,
            rng=np.random.default_rng(seed),
        )
        probabilities = code_probabilities(rates)[0, 0]
        assert goodness_of_fit(counts, probabilities) > 1e-4
        if light > 1:  # and the test can tell: without pile-up the same counts don't fit
            flat = code_probabilities(replace(rates, pile_up=False))[0, 0]
            assert goodness_of_fit(counts, flat) < 1e-12


def test_probabilities_sum_to_one_and_code_zero_is_the_empty_exposure(paper):
    rates = expected_rates(scene("fig1", paper), paper)
    probabilities = code_probabilities(rates, slice(50, 60))
    assert probabilities.shape == (10, 128, 512)
    np.testing.assert_allclose(probabilities.sum(axis=-1), 1, atol=1e-12)
    np.testing.assert_allclose(
        probabilities[..., 0], np.exp(-rates.rows(slice(50, 60)).detections()), atol=1e-7
    )
    assert not probabilities[..., 500:].any()  # no code lies beyond the period
    assert (probabilities >= 0).all()


def test_tiles_are_the_whole_cut_in_rows(paper, resized, monkeypatch):
    monkeypatch.setattr("hueflight.simulator.probabilities._TILE_BYTES", 1 << 19)
    instrument = resized(paper, 19, 30)
    rates = expected_rates(scene("staircase", instrument), instrument)
    whole = code_probabilities(rates)
    seen = np.zeros(19, dtype=int)
    for rows, part in probability_tiles(rates):
        np.testing.assert_allclose(part, whole[rows], atol=1e-12)
        seen[rows] += 1
        assert part.nbytes <= 1 << 19
    assert (seen == 1).all()


@given(delay=st.floats(-400, 900), band=st.integers(0, 8))
@hypothesis_settings(max_examples=60)
def test_table_agrees_with_exact_pulses_to_its_bound(delay, band):
    paper = Instrument.load("paper")
    bins = paper.time_bins()
    delays = np.array([delay, delay + 0.61803])
    table = PulseTable.build(paper, bins, delays)
    photons = np.zeros((9, 2))
    photons[band] = 1
    found = table.expected(photons, delays)
    for row, each in zip(found, delays, strict=True):
        (pulse,) = paper.pulses(band)
        exact = replace(pulse, center_ns=pulse.center_ns + each).share(bins.edges_ns, 320.0)
        assert np.abs(row - exact).max() < 1e-7


def test_table_bound_is_not_idle(paper):
    # a grid four times coarser would break it (error ∝ h⁴, so ×256)
    bins, delays = paper.time_bins(), np.linspace(0, 1, 100)
    (pulse,) = paper.pulses(8)
    exact = np.array([
        replace(pulse, center_ns=pulse.center_ns + each).share(bins.edges_ns, 320.0)
        for each in delays
    ])  # fmt: skip
    photons = np.zeros((9, delays.size))
    photons[8] = 1
    error = np.abs(PulseTable.build(paper, bins, delays).expected(photons, delays) - exact).max()
    assert 1e-10 < error < 1e-7


def test_pile_up_favours_early_light_by_the_published_share():
    # notes on physics: first to last band 0.4–1.3 % at 18.6 kfps with 63–95 % hits: the light of
    # one period, −ln(1 − hits)/168
    for hits, published in ((0.63, 0.006), (0.95, 0.018)):
        per_period = -np.log(1 - hits) / 168
        expected = np.full(500, per_period / 500)
        with_pile_up = first_photon_probabilities(expected, 168, pile_up=True)
        bias = with_pile_up[0] / with_pile_up[-1] - 1
        assert bias == pytest.approx(published, rel=0.05)
        without = first_photon_probabilities(expected, 168, pile_up=False)
        np.testing.assert_allclose(without, hits / 500)
        assert with_pile_up.sum() == pytest.approx(hits)


def test_nothing_gives_nothing():
    dark = first_photon_probabilities(np.zeros((3, 10)), 168, pile_up=True)
    assert not dark.any()


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_direction_and_missing_empty_code(paper, direction):
    sensor = msgspec.structs.replace(
        paper.sensor, rows=1, cols=1, direction=direction, code_zero="bin"
    )
    instrument = paper.replace(sensor=sensor)
    rates = expected_rates(scene("plane", instrument), instrument, SimulationSettings.ideal())
    probabilities = code_probabilities(rates)[0, 0]
    assert probabilities.sum() == pytest.approx(float(rates.occupancy()[0, 0]), abs=1e-7)
    # the brightest band within its first pulses: deep red at 25 + 6.7 ns, code ≈ 49 or its mirror
    violet = 25 + 240 + 2 / 0.299792458
    code = violet / 0.642 if direction == "forward" else (320 - violet) / 0.642
    near = np.arange(512)[probabilities > 0.5 * probabilities.max()]
    assert np.abs(near - code).min() < 6


def test_single_shot_has_no_circle(paper):
    timing = msgspec.structs.replace(paper.timing, period_ns=None)
    sensor = msgspec.structs.replace(paper.sensor, rows=1, cols=1, direction="forward")
    instrument = paper.replace(timing=timing, sensor=sensor)
    near = expected_rates(scene("plane", instrument), instrument, SimulationSettings.ideal())
    assert near.periods == 1
    far = replace(near, delay_ns=near.delay_ns + 200)  # most of the train leaves the window
    assert code_probabilities(far)[0, 0, 1:].sum() < 0.6 * code_probabilities(near)[0, 0, 1:].sum()
