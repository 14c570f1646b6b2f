# SPDX-License-Identifier: Apache-2.0
"""The whole illuminator against the plain model: every edge of every LED, equal to the tick."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hueflight_hdl.illuminator.gearing.ecp5 import Ecp5Gearing
from hueflight_hdl.illuminator.gearing.interface import Gearing
from hueflight_hdl.illuminator.gearing.portable import DoubleDataRateGearing, SingleDataRateGearing
from hueflight_hdl.illuminator.illuminator import IlluminatorConfig
from hueflight_hdl.illuminator.pulse_generator.config import PulseConfig
from hueflight_hdl.illuminator.pulse_generator.reference import Pulse, Schedule
from hueflight_hdl.testbench.illuminator_trials import (
    Prediction,
    Trial,
    TrialTestbench,
    predictions,
)
from support.illuminator_stimuli import random_schedule, random_trigger, small_illuminator

GEARINGS: dict[str, Gearing] = {
    "1:1": SingleDataRateGearing(),
    "2:1": DoubleDataRateGearing(),
    "4:1": Ecp5Gearing(),
}
Make = Callable[..., TrialTestbench]


@pytest.fixture(scope="module")
def make_bench(simulator: None) -> Make:
    """A bench for a gearing, compiled once."""
    benches: dict[str, TrialTestbench] = {}

    def make(gearing: str) -> TrialTestbench:
        if gearing not in benches:
            found = GEARINGS[gearing]
            benches[gearing] = TrialTestbench(small_illuminator(found.lanes), found)
        return benches[gearing]

    return make


def random_trial(rng: np.random.Generator, config: PulseConfig) -> Trial:
    """Two schedules, and arming, swap and disarming anywhere in their trains."""
    clocks, lanes = 1400, config.lanes
    banks = tuple(random_schedule(rng, config, longest=1024 * lanes) for _ in range(2))
    period = banks[int(rng.integers(2))].period
    trigger = random_trigger(rng, ticks=clocks * lanes, lanes=lanes, period=period)
    trigger[-8:] = False
    # requests must not overtake one another: they take up to 300 clocks
    return Trial(
        (banks[0], banks[1]),
        trigger,
        arm=2 * int(rng.integers(0, 60)),
        swap=2 * int(rng.integers(160, 330)) if rng.random() < 0.8 else None,
        disarm=2 * int(rng.integers(480, 600)) if rng.random() < 0.5 else None,
        restart=bool(rng.integers(2)),
        falling=bool(rng.integers(2)),
    )


def assert_equal(bench: TrialTestbench, trial: Trial) -> Prediction:
    """Play a trial; one of what the model allows must be what came out, all of it."""
    before = np.array(bench.counters())
    shot = bench.play(trial)
    *counted, swaps = (np.array(bench.counters()) - before).tolist()
    nearest = None
    for wanted in predictions(bench.config.pulse, trial, shot):
        wrong = np.argwhere(shot.levels != wanted.levels)
        # the first train's bank may differ from that of the last one before
        same = counted == counts(wanted) and swaps - wanted.swaps in (0, 1)
        if same and not len(wrong):
            return wanted
        nearest = wrong if nearest is None or len(wrong) < len(nearest) else nearest
    assert nearest is not None
    first = nearest[0].tolist() if len(nearest) else "only counters"
    raise AssertionError(f"{len(nearest)} ticks of the nearest differ, {first} first: {trial}")


def counts(wanted: Prediction) -> list[int]:
    """Triggers seen, served and ignored, and restarts."""
    served = len(wanted.trains)
    restarts = sum(train.restarted for train in wanted.trains)
    return [served + wanted.ignored, served, wanted.ignored, restarts]


def assert_trials(bench: TrialTestbench, *, trials: int, seed: int) -> None:
    """Compare every trial."""
    rng = np.random.default_rng(seed)
    ignored = restarts = swaps = lit = 0
    phases = np.zeros(bench.config.pulse.lanes, int)
    for _ in range(trials):
        found = assert_equal(bench, random_trial(rng, bench.config.pulse))
        lit += int(found.levels.any())
        ignored += found.ignored
        restarts += counts(found)[3]
        swaps += found.swaps
        phases += np.bincount([t.tick % len(phases) for t in found.trains], minlength=len(phases))
    # the stimuli do what they should: light, swaps, ignored triggers, restarts, every phase
    assert lit > trials / 2
    assert min(ignored, restarts, swaps, *phases) > trials / 4


def test_random_trials(make_bench: Make):
    """160 random schedules in the gearing of ECP5."""
    assert_trials(make_bench("4:1"), trials=80, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize(("gearing", "trials"), [("1:1", 800), ("2:1", 1400), ("4:1", 2900)])
def test_ten_thousand_schedules(make_bench: Make, gearing: str, trials: int):
    """Two schedules a trial: 10 200 in all, with some hundred thousand triggers at all phases."""
    assert_trials(make_bench(gearing), trials=trials, seed=trials)


def one_trigger(tick: int, *, clocks: int, lanes: int) -> np.ndarray:
    level = np.zeros(clocks * lanes, bool)
    level[tick : tick + 5] = True
    return level


@pytest.mark.parametrize(
    "gearing",
    [pytest.param(name, marks=() if name == "4:1" else pytest.mark.slow) for name in GEARINGS],
)
def test_the_first_shot(make_bench: Make, gearing: str):
    """The first trigger ever after configuration, at each of its phases."""
    lanes = GEARINGS[gearing].lanes
    pulses = [[Pulse(5, 7), Pulse(40, 3)] + [Pulse(0, 0)] * 2] * 3
    bank = Schedule(256, 7, pulses)
    for phase in range(lanes):
        bench = make_bench(gearing)
        bench.configure()
        trigger = one_trigger(400 * lanes + phase, clocks=800, lanes=lanes)
        found = assert_equal(bench, Trial((bank, bank), trigger))
        assert found.levels.sum() == 3 * (7 + 3)


def test_a_missed_trigger_is_told_to_the_camera(make_bench: Make):
    """High for sixteen clocks after each, so that a camera at a tenth of the clock sees it."""
    bench = make_bench("4:1")
    bank = Schedule(256, 7, [[Pulse(5, 7)] + [Pulse(0, 0)] * 3] * 3)
    trigger = np.zeros(4 * 900, bool)
    for clock in (300, 340, 500, 530):  # the second and the fourth come within 64 clocks
        trigger[4 * clock : 4 * clock + 4] = True
    missed = bench.play(Trial((bank, bank), trigger)).missed
    change = np.diff(missed.astype(int))
    rises, falls = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
    assert len(rises) == 2
    assert ((falls - rises) == 16).all()
    assert rises[1] - rises[0] == 530 - 340
    assert bench.gearing.input_latency < rises[0] - 340 < bench.latency_clocks


@pytest.mark.slow
@pytest.mark.parametrize("gearing", GEARINGS)
def test_the_papers_schedule_from_pin_to_pin(simulator: None, gearing: str):
    """Table 1: rising edges at 0, 24, 48 … 192 ticks, 8 ticks wide, at every phase."""
    found = GEARINGS[gearing]
    lanes = found.lanes
    pulse = PulseConfig(channels=9, pulses=1, steps=1, lanes=lanes)
    bench = TrialTestbench(IlluminatorConfig(pulse, pulse_hz=20e6, baud=1e6), found)
    # a train is busy for less than its period, so that the next trigger may come early
    bank = Schedule(256 - lanes, 0x1FF, [[Pulse(24 * channel, 8)] for channel in range(9)])
    starts = [600 * lanes + 257 * number for number in range(12)]  # each phase in turn
    trigger = np.zeros(600 * lanes + 257 * 14 // lanes * lanes, bool)
    for start in starts:
        trigger[start : start + 5] = True
    levels = bench.play(Trial((bank, bank), trigger)).levels
    for channel, level in enumerate(levels):
        change = np.diff(np.concatenate(([0], level.astype(int))))
        wanted = [start + 24 * channel for start in starts]
        assert np.flatnonzero(change > 0).tolist() == wanted
        assert np.flatnonzero(change < 0).tolist() == [start + 8 for start in wanted]
