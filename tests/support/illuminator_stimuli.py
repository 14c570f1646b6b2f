# SPDX-License-Identifier: Apache-2.0
"""Small pulse generators and random stimuli for them."""

from __future__ import annotations

import numpy as np

from hueflight_hdl.illuminator.illuminator import IlluminatorConfig
from hueflight_hdl.illuminator.pulse_generator.config import Limits, PulseConfig
from hueflight_hdl.illuminator.pulse_generator.reference import Pulse, Schedule
from hueflight_hdl.testbench.pulse_generator import Stimulus

# three channels: usual limits, tight ones, and none that matters
SMALL_LIMITS = (Limits(), Limits(40, 4, 40), Limits(4000, 1, 4000))


def small_config(lanes: int) -> PulseConfig:
    return PulseConfig(channels=3, pulses=2, steps=8, lanes=lanes, limits=SMALL_LIMITS)


def small_illuminator(lanes: int) -> IlluminatorConfig:
    """Three channels: usual limits, tight ones, and none that matters."""
    limits = (Limits(), Limits(40, 4, 40), Limits(1000, 1, 1000))
    pulse = PulseConfig(channels=3, pulses=4, steps=2, lanes=lanes, limits=limits)
    return IlluminatorConfig(pulse, pulse_hz=20e6, clock_ratio=1 if lanes == 1 else 2, baud=1e6)


def random_schedule(
    rng: np.random.Generator, config: PulseConfig, *, longest: int = 4096
) -> Schedule:
    """Anything that registers can hold, often something that makes sense."""
    shortest = 8 * config.lanes
    period = int(
        rng.choice([256, 128, rng.integers(shortest, 300 + shortest), rng.integers(1, longest + 1)])
    )

    def pulse() -> Pulse:
        width = rng.choice(
            [0, 1, 2, 3, 8, rng.integers(30), rng.integers(200), rng.integers(config.widest + 1)]
        )
        return Pulse(int(rng.integers(0, min(period + 10, 4096))), int(width))

    everything = (1 << config.channels) - 1
    enable = int(rng.integers(everything + 1)) if rng.random() < 0.3 else everything
    pulses = [[pulse() for _ in range(config.pulses)] for _ in range(config.channels)]
    return Schedule(period, enable, pulses)


def random_trigger(rng: np.random.Generator, *, ticks: int, lanes: int, period: int) -> np.ndarray:
    """Edges at any phase: regular with jitter, dense, or sparse."""
    level = np.zeros(ticks, bool)
    kind = rng.integers(4)
    at = int(rng.integers(lanes, 60 * lanes))
    while at < ticks:
        high = int(rng.integers(1, 40))
        level[at : at + high] = True
        if kind == 0:
            step = period + int(rng.integers(-1, 2))
        else:
            step = high + int(rng.integers(1, (20, 500, 5000)[kind - 1]))
        at += max(step, high + 1)
    return level


def random_stimulus(rng: np.random.Generator, config: PulseConfig, *, clocks: int) -> Stimulus:
    """Schedules, triggers, swaps and disarming, all at random moments."""
    banks = (random_schedule(rng, config), random_schedule(rng, config))
    ticks = clocks * config.lanes
    bank = np.zeros(clocks, int)
    for clock in rng.integers(0, clocks, rng.integers(0, 6)):
        bank[clock:] ^= 1
    armed = np.ones(clocks, bool)
    for clock in rng.integers(0, clocks, rng.integers(0, 3)):
        armed[clock:] ^= True
    return Stimulus(
        banks,
        random_trigger(rng, ticks=ticks, lanes=config.lanes, period=banks[0].period),
        bank=bank,
        armed=armed,
        restart=bool(rng.integers(2)),
        falling=bool(rng.integers(2)),
    )
