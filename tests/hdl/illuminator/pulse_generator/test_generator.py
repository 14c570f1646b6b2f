# SPDX-License-Identifier: Apache-2.0
"""The gateware against its model: every edge of every channel, equal to the tick."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hueflight_hdl.illuminator.pulse_generator.config import Limits, PulseConfig
from hueflight_hdl.illuminator.pulse_generator.reference import Pulse, Schedule
from hueflight_hdl.testbench.pulse_generator import PulseTestbench, Stimulus, expected
from support.illuminator_stimuli import random_stimulus, small_config

Make = Callable[[PulseConfig], PulseTestbench]
LANES = (1, 2, 4)


def assert_equal(bench: PulseTestbench, stimulus: Stimulus, *, settle: bool = True) -> int:
    """Compare gateware and model; return how many ticks were on."""
    found = bench.run(stimulus, settle=settle).levels
    wanted = expected(bench.config, stimulus).levels
    for channel in range(bench.config.channels):
        wrong = np.flatnonzero(found[channel] != wanted[channel])
        assert not wrong.size, (
            f"channel {channel}, tick {wrong[0]}: {found[channel][wrong[0]]}, {stimulus}"
        )
    return int(wanted.sum())


def assert_random(bench: PulseTestbench, *, trials: int, clocks: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    on = sum(
        assert_equal(bench, random_stimulus(rng, bench.config, clocks=clocks))
        for _ in range(trials)
    )
    assert on > 100 * trials  # the stimuli do make light


@pytest.mark.parametrize("lanes", LANES)
def test_random_schedules_and_triggers(bench: Make, lanes: int):
    assert_random(bench(small_config(lanes)), trials=60, clocks=1500, seed=lanes)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", LANES)
def test_many_random_schedules_and_triggers(bench: Make, lanes: int):
    assert_random(bench(small_config(lanes)), trials=300, clocks=1200, seed=10 + lanes)


def one_pulse(config: PulseConfig, *, delay: int, width: int, period: int = 256) -> Schedule:
    pulses = [[Pulse(delay, width)] + [Pulse(0, 0)] * (config.pulses - 1)] * config.channels
    return Schedule(period, -1 & (1 << config.channels) - 1, pulses)


def triggered(config: PulseConfig, *at: int, clocks: int) -> np.ndarray:
    level = np.zeros(clocks * config.lanes, bool)
    for tick in at:
        level[tick : tick + 3] = True
    return level


@pytest.mark.parametrize("lanes", LANES)
def test_the_first_shot_after_configuration(lanes: int, bench: Make):
    """A fresh design, no clock before the trigger's but those that its first edge takes."""
    config = small_config(lanes)
    for phase in range(lanes):
        fresh = PulseTestbench(config)
        schedule = one_pulse(config, delay=5, width=7)
        # the settings must be there before the first trigger: sixteen clocks
        trigger = triggered(config, 16 * lanes + phase, clocks=120)
        stimulus = Stimulus((schedule, schedule), trigger)
        assert assert_equal(fresh, stimulus, settle=False) == 7 * config.channels


@pytest.mark.parametrize("lanes", LANES)
def test_a_second_trigger_at_every_distance(bench: Make, lanes: int):
    """Ignored or restarted at every tick of a train, and at every phase of the first."""
    config = small_config(lanes)
    period, first = 40 * lanes, 24 * lanes
    schedule = Schedule(
        period, 7, [[Pulse(2, 5), Pulse(period - 1, 9)], [Pulse(3, 1), Pulse(4, 30)]] * 2
    )
    schedule = Schedule(period, 7, schedule.pulses[:3])
    for distance in range(4, period + 2 * lanes, 1 if lanes < 4 else 3):
        for restart in (False, True):
            start = first + distance % lanes
            trigger = triggered(config, start, start + distance, clocks=160)
            assert_equal(bench(config), Stimulus((schedule, schedule), trigger, restart=restart))


@pytest.mark.parametrize("lanes", LANES)
def test_banks_swap_between_trains_whenever_asked(bench: Make, lanes: int):
    """Whatever clock of a train the swap comes in, a train is of one bank, whole."""
    config = small_config(lanes)
    period = 16 * lanes
    banks = (
        Schedule(period, 7, [[Pulse(0, 3), Pulse(9, 3)]] * 3),
        Schedule(period, 7, [[Pulse(period - 2, 5), Pulse(6, 1)]] * 3),
    )
    trigger = triggered(config, *range(24 * lanes, 90 * lanes, period), clocks=130)
    for swap in range(40, 60):
        bank = (np.arange(130) >= swap).astype(int)
        assert_equal(bench(config), Stimulus(banks, trigger, bank=bank))


@pytest.mark.parametrize("lanes", LANES)
def test_disarming_darkens_in_the_middle_of_a_pulse(bench: Make, lanes: int):
    config = small_config(lanes)
    schedule = one_pulse(config, delay=0, width=8 * lanes)
    trigger = triggered(config, 24 * lanes, clocks=80)
    totals = set()
    for clock in range(35, 60):
        armed = np.arange(80) < clock
        totals.add(assert_equal(bench(config), Stimulus((schedule,) * 2, trigger, armed=armed)))
    assert len(totals) > 5  # some came before the pulse, some within it, some after


def table_1(lanes: int) -> tuple[PulseConfig, Schedule]:
    """The paper's schedule: nine channels, 10 ns wide, 30 ns apart, in ticks of 1.25 ns."""
    config = PulseConfig(channels=9, pulses=1, lanes=lanes, steps=1)
    pulses = [[Pulse(24 * channel, 8)] for channel in range(9)]
    return config, Schedule(256, 0x1FF, pulses)


@pytest.mark.parametrize(
    "lanes", [pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow), 4]
)
def test_the_papers_schedule(bench: Make, lanes: int):
    """Rising edges at 0, 24, 48 … 192 ticks and 8 ticks wide, whatever the trigger's phase."""
    config, schedule = table_1(lanes)
    starts = [64 * lanes + 257 * number for number in range(12)]  # each phase in turn
    trigger = triggered(config, *starts, clocks=64 + (257 * 12 + 256) // lanes)
    levels = bench(config).run(Stimulus((schedule, schedule), trigger)).levels
    for channel in range(9):
        change = np.diff(np.concatenate(([0], levels[channel].astype(int))))
        wanted = [start + 24 * channel for start in starts]
        assert np.flatnonzero(change > 0).tolist() == wanted
        assert np.flatnonzero(change < 0).tolist() == [start + 8 for start in wanted]


def test_no_schedule_exceeds_the_limits(bench: Make):
    """What comes out is within the limits as they are stated, not as the model computes them."""
    config = small_config(4)
    rng = np.random.default_rng(99)
    for _ in range(20):
        levels = bench(config).run(random_stimulus(rng, config, clocks=3000)).levels
        for channel, level in enumerate(levels):
            check_limits(level, config.limit(channel))


def check_limits(level: np.ndarray, limits: Limits) -> None:
    change = np.diff(np.concatenate(([0], level.astype(int), [0])))
    lengths = np.flatnonzero(change < 0) - np.flatnonzero(change > 0)
    assert lengths.max(initial=0) <= limits.max_on_ticks
    # for every stretch from i to j: on(i..j) - (j - i) / divisor <= burst
    excess = np.concatenate(([0], np.cumsum(limits.duty_divisor * level - 1.0)))
    lowest_before = np.minimum.accumulate(excess)
    worst = (excess - lowest_before).max() / limits.duty_divisor
    if limits.duty_divisor > 1:
        assert worst <= limits.burst_ticks
