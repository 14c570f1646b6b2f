# SPDX-License-Identifier: Apache-2.0
"""The fast clock's counter against plain counting, across its halves and at its end."""

from __future__ import annotations

import numpy as np
import pytest

from hueflight_hdl.common.fast_counter import FastCounter
from hueflight_hdl.testbench.cxxrtl import Simulation, simulate


@pytest.fixture(scope="module")
def counter(simulator: None) -> Simulation:
    return simulate(FastCounter(), clocks={"pulse": 1})


def test_every_clock_shows_a_count_that_was(counter: Simulation):
    """Also where the low half carries into the high one."""
    records = counter.inputs(200_000)
    rng = np.random.default_rng(1)
    records["event"] = rng.random(len(records)) < 0.8
    records["event"][:3] = 0
    records["clear"][0] = 1
    records["clear"][150_000] = 1
    outputs = counter.run(records)
    events = records["event"].astype(np.int64)
    for begin, end in ((1, 150_000), (150_001, len(records))):
        counted = np.cumsum(events[begin:end])
        late = 4  # shown after the third edge
        assert (outputs["value"][begin : begin + late] == 0).all()
        assert (outputs["value"][begin + late : end] == counted[:-late]).all()
    assert counted[-1] > 0
    assert outputs["value"].max() > 1 << 16
    assert not outputs["saturated"].any()


def test_the_end_is_not_passed(simulator: None):
    """Eight bits: at 255 it stays, whatever comes, until cleared."""
    small = simulate(FastCounter(8), clocks={"pulse": 1})
    records = small.inputs(1000)
    records["event"] = np.random.default_rng(2).random(len(records)) < 0.7
    records["clear"][800] = 1
    outputs = small.run(records)
    counted = np.cumsum(records["event"].astype(int))[:800]
    assert (outputs["value"][4:801] == np.minimum(counted, 255)[:797]).all()
    first = int(np.flatnonzero(counted == 256)[0])
    assert np.flatnonzero(outputs["saturated"])[0] == first + 4
    assert outputs["saturated"][first + 4 : 801].all()
    assert not outputs["saturated"][801:805].any()
    assert outputs["value"][801] == 0
