# SPDX-License-Identifier: Apache-2.0
"""Crosstalk and afterpulses against closed forms and a simulation, exposure by exposure."""

import numpy as np
import pytest

from hueflight import Instrument
from hueflight.errors import SceneError
from hueflight.simulator import (
    Effects,
    SimulationSettings,
    code_probabilities,
    effect_truth,
    expected_rates,
    scene,
    simulate_codes,
    simulate_histogram,
)

PERIOD_NS = 100.0
TOML = """
name = "test"
[sensor]
rows = 3
cols = 4
code_bits = 7
bin_width_ns = 1
code_zero = "no photon"
dark_count_hz = 0
{exposure}
[timing]
period_ns = 100
[[bands]]
name = "blue"
wavelength_nm = 450
delay_ns = 30
pulse_fwhm_ns = 8
"""
SINGLE = Instrument.from_toml(TOML.format(exposure=""))
LONG = Instrument.from_toml(TOML.format(exposure="exposure_ms = 0.002"))  # 20 periods


def settings(occupancy: float, **effects: float) -> SimulationSettings:
    """White at 1 m fills this fraction of exposures, and there is no other light."""
    return SimulationSettings.ideal(
        white_detections=-np.log(1 - occupancy), effects=Effects(**effects)
    )


def rates_of(instrument: Instrument, chosen: SimulationSettings):
    plane = scene("plane", instrument, distance=1.0, surface=1.0)
    return plane, expected_rates(plane, instrument, chosen)


@pytest.mark.parametrize("occupancy", [0.1, 0.6])
def test_afterpulses_raise_the_fraction_of_exposures_with_a_count(occupancy):
    share = 0.05
    # a lifetime of 1 ns: a trapped carrier always fires first, at the start of the exposure
    chosen = settings(occupancy, afterpulse_share=share, afterpulse_ns=1.0)
    plane, rates = rates_of(SINGLE, chosen)
    p = code_probabilities(rates)
    counted = occupancy / (1 - share * (1 - occupancy))
    assert 1 - p[..., 0] == pytest.approx(counted, rel=1e-9)
    assert p.sum(axis=-1) == pytest.approx(1)
    assert effect_truth(plane, SINGLE, chosen).trapped == pytest.approx(share * counted, rel=1e-9)
    # code n ends n ns after the start of the exposure
    early = p[0, 0, 1:3].sum() / p[0, 0, 1:10].sum()
    assert early == pytest.approx(np.expm1(-2.0) / np.expm1(-9.0), rel=1e-4)


def test_afterpulses_decay_over_the_exposure_with_their_lifetime():
    share, lifetime, occupancy = 0.1, 40.0, 0.2
    _, with_pulses = rates_of(
        LONG, settings(occupancy, afterpulse_share=share, afterpulse_ns=lifetime)
    )
    _, without = rates_of(LONG, settings(occupancy))
    p, q = code_probabilities(with_pulses)[0, 0], code_probabilities(without)[0, 0]
    # before the pulse (at 43 ns) only afterpulses; 20 periods of light dim a trapped carrier's
    # exposure by exp(-light per period) for each turn of the period
    light = -np.log(1 - occupancy) / 20
    turns = np.exp(-(PERIOD_NS / lifetime + light) * np.arange(20)).sum()
    counted = 1 - p[0]
    start = np.exp(-np.arange(19) / lifetime) * -np.expm1(-1 / lifetime) * turns
    assert p[1:20] - (1 - share * counted) * q[1:20] == pytest.approx(
        share * counted * start, rel=1e-6
    )


def test_crosstalk_adds_the_light_of_the_neighbors_in_proportion():
    share, dim = 0.02, 1e-4
    plane, rates = rates_of(SINGLE, settings(dim, crosstalk_share=share))
    _, without = rates_of(SINGLE, settings(dim))
    ratio = (1 - code_probabilities(rates)[..., 0]) / (1 - code_probabilities(without)[..., 0])
    neighbors = np.array([[2, 3, 3, 2], [3, 4, 4, 3], [2, 3, 3, 2]])
    assert ratio == pytest.approx(1 + share * neighbors, rel=1e-4)
    truth = effect_truth(plane, SINGLE, settings(dim, crosstalk_share=share))
    assert truth.crosstalk == pytest.approx(share * neighbors * dim, rel=1e-3)


def test_dead_pixels_neither_cause_crosstalk_nor_count_it():
    chosen = settings(1e-4, crosstalk_share=0.02, afterpulse_share=0.1).replace(dead_share=0.2)
    plane, rates = rates_of(SINGLE, chosen)
    dead = ~rates.secondary.alive
    assert dead.sum() == 3
    p = code_probabilities(rates)
    assert np.all(p[dead][:, 0] == 1)
    alive = np.pad(~dead, 1)
    neighbors = alive[:-2, 1:-1] * 1 + alive[2:, 1:-1] + alive[1:-1, :-2] + alive[1:-1, 2:]
    truth = effect_truth(plane, SINGLE, chosen)
    assert truth.crosstalk == pytest.approx(0.02 * 1e-4 * neighbors, rel=1e-3)
    assert np.all(truth.trapped[dead] == 0)


def test_rows_of_different_positions_of_a_scan_are_not_neighbors():
    line = Instrument.from_toml(
        TOML.format(exposure="scan_steps = 5").replace("rows = 3", "rows = 1")
    )
    plane, rates = rates_of(line, settings(1e-4, crosstalk_share=0.02))
    _, without = rates_of(line, settings(1e-4))
    ratio = (1 - code_probabilities(rates)[..., 0]) / (1 - code_probabilities(without)[..., 0])
    assert ratio == pytest.approx(np.tile(1 + 0.02 * np.array([1, 2, 2, 1]), (5, 1)), rel=1e-4)
    # a block of rows is the same part of the picture
    p = code_probabilities(rates)
    assert np.array_equal(code_probabilities(rates, slice(2, 4)), p[2:4])
    chosen = settings(1e-4, crosstalk_share=0.02)
    codes = simulate_codes(plane, line, frames=10, settings=chosen, rows=slice(1, 2))
    assert next(codes).shape == (10, 1, 4)


def test_both_follow_a_simulation_photon_by_photon(goodness_of_fit):
    """Two pixels beside each other and their exposures one after the other, avalanche by avalanche.

    The simulation keeps all that the equations leave out of second order; its size here is below
    the noise.
    """
    crosstalk, trapped, lifetime, occupancy, frames = 0.05, 0.1, 15.0, 0.5, 150_000
    pair = Instrument.from_toml(
        TOML.format(exposure="").replace("rows = 3", "rows = 1").replace("cols = 4", "cols = 2")
    )
    chosen = settings(
        occupancy, crosstalk_share=crosstalk, afterpulse_share=trapped,
        afterpulse_ns=lifetime,
    )  # fmt: skip
    plane, rates = rates_of(pair, chosen)
    p = code_probabilities(rates)
    alone = code_probabilities(rates_of(pair, settings(occupancy))[1])[0, 0]
    rng = np.random.default_rng(8)
    order = np.append(np.arange(1, 128), 0)
    outcomes = np.append(np.arange(127) + 0.5, np.inf)
    own = rng.choice(outcomes, size=(frames, 2), p=alone[order])
    carrier = rng.exponential(lifetime, size=(frames, 2))
    couples = rng.random((frames, 2)) < crosstalk
    keeps = rng.random((frames, 2)) < trapped
    loaded = np.zeros(2, bool)
    counts = np.zeros(128)
    for frame in range(frames):
        first = own[frame].copy()
        for pixel in (0, 1):
            if loaded[pixel]:
                first[pixel] = min(first[pixel], carrier[frame, pixel])
        both = first.copy()
        for pixel in (0, 1):
            if couples[frame, pixel]:
                both[pixel] = min(both[pixel], first[1 - pixel])
        fired = both < PERIOD_NS
        counts[int(both[0]) + 1 if fired[0] else 0] += 1
        loaded = fired & keeps[frame]
    # consecutive exposures are correlated by a few per cent, which the limit allows for
    assert goodness_of_fit(counts, p[0, 0]) > 1e-4
    assert goodness_of_fit(counts, alone) < 1e-12
    drawn = simulate_histogram(plane, pair, frames=frames, settings=chosen, seed=3)
    assert goodness_of_fit(drawn[0, 1], p[0, 1]) > 1e-4


def test_too_much_crosstalk_is_refused():
    with pytest.raises(SceneError, match=r"effects\.crosstalk_share = 0\.3"):
        Effects(crosstalk_share=0.3)
