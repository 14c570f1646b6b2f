# SPDX-License-Identifier: Apache-2.0
"""The trigger's filter: glitches start no train, and edges that last keep their tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hueflight_hdl.illuminator.pulse_generator.config import PulseConfig
from hueflight_hdl.illuminator.pulse_generator.reference import Pulse, Schedule, find_edges
from hueflight_hdl.testbench.pulse_generator import PulseTestbench, Stimulus, expected
from hueflight_protocol.illuminator_map import MAX_FILTER_TICKS
from support.illuminator_stimuli import random_stimulus, small_config

Make = Callable[[PulseConfig], PulseTestbench]
LANES = pytest.mark.parametrize(
    "lanes", [pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow), 4]
)


def noisy(rng: np.random.Generator, *, ticks: int) -> np.ndarray:
    """A level that changes after 1 to 20 ticks, or after hundreds."""
    lengths = np.where(
        rng.random(ticks) < 0.9, rng.integers(1, 20, ticks), rng.integers(20, 400, ticks)
    )
    return (np.repeat(np.arange(ticks) % 2, lengths)[:ticks]).astype(bool)


def brute_force(level: np.ndarray, *, width: int, falling: bool) -> list[int]:
    """Edges by the words of the register map, one tick after another."""
    level = level ^ falling
    padded = np.concatenate((np.repeat(level[:1], width), level, np.repeat(level[-1:], width)))
    return [
        tick
        for tick in range(1, len(level))
        if padded[tick + width : tick + 2 * width].all() and not padded[tick : tick + width].any()
    ]


@pytest.mark.parametrize("falling", [False, True])
def test_the_reference_finds_what_the_register_map_says(falling: bool):
    level = noisy(np.random.default_rng(3), ticks=4000)
    for width in range(1, MAX_FILTER_TICKS + 1):
        found = find_edges(level, lanes=1, falling=falling, width=width)
        assert found.tolist() == brute_force(level, width=width, falling=falling)


@LANES
def test_noisy_triggers_with_every_width(bench: Make, lanes: int):
    config = small_config(lanes)
    rng = np.random.default_rng(lanes)
    served = set()
    for width in (*range(MAX_FILTER_TICKS + 1), 15):
        for _ in range(3):
            trial = random_stimulus(rng, config, clocks=1500)
            level = noisy(rng, ticks=len(trial.trigger))
            stimulus = replace(trial, trigger=level, filter_width=min(width, MAX_FILTER_TICKS))
            wanted = expected(config, stimulus)
            found = bench(config).run(replace(stimulus, filter_width=width))
            assert np.array_equal(found.levels, wanted.levels), (width, stimulus)
            served.add(len(wanted.trains))
    assert len(served) > 5  # widths do make a difference


@LANES
def test_a_glitch_at_every_phase_and_length(bench: Make, lanes: int):
    """A pulse of the trigger as long as the width fires at its own tick; a shorter one does not."""
    config = small_config(lanes)
    bank = Schedule(8 * lanes, 7, [[Pulse(0, lanes), Pulse(0, 0)]] * 3)
    for length in range(1, MAX_FILTER_TICKS + 1):
        for phase in range(lanes):
            start = 24 * lanes + phase
            level = np.zeros(70 * lanes, bool)
            level[start : start + length] = True
            levels = bench(config).run(Stimulus((bank, bank), level, filter_width=5)).levels
            on = np.flatnonzero(levels[0]).tolist()
            assert on == (list(range(start, start + lanes)) if length >= 5 else [])
