# SPDX-License-Identifier: Apache-2.0
"""The clock of a camera's logic through changes and losses, against what registers need of it.

Between two edges lies at least half a period, whatever happens to PLL and reference; and it runs
only while the PLL has locked, but for one whole pulse.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from amaranth.build import Attrs, Pins, Resource
from amaranth.hdl import ClockSignal, Elaboratable, Module
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from hueflight_hdl.boards import ecp5_reference
from hueflight_hdl.boards.ecp5_camera import CameraClocks
from hueflight_hdl.boards.ecp5_reference import reference_from_pins
from hueflight_hdl.boards.pins import drive_pin, input_of, read_pin
from hueflight_hdl.boards.target import Target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.pin_events import PinBench

US = 1_000_000
HALF_OSCILLATOR_PS, HALF_REFERENCE_PS = 20_000, 50_000
HALF_SYNC_PS = 5_000
SETTLE_US, LOCK_US, PRESENT_US = 20, 60, 120
CASE_US = PRESENT_US + 2 * (3 * SETTLE_US + LOCK_US)
CASES = 40
_ATTRS = Attrs(IO_TYPE="LVCMOS33")

pytestmark = pytest.mark.slow


class ClockTop(Elaboratable):
    """A camera's clocks, with the one of its logic on a pin."""

    def elaborate(self, platform):
        m = Module()
        oscillator = input_of(m, "oscillator", platform.request("clk25", 0, dir="-"))
        reference = reference_from_pins(m, platform, oscillator, 10_000_000)
        m.d.comb += reference.wanted.eq(read_pin(m, platform, "wanted"))
        CameraClocks(oscillator, 25e6, reference=reference).add_to(m, platform)
        drive_pin(m, platform, "sync_out", ClockSignal("sync"))
        return m


def platform():
    made = ULX3S_85F_Platform()
    pins = {"reference": ("12+", "i"), "wanted": ("0+", "i"), "sync_out": ("1+", "o")}
    made.add_resources(
        [
            Resource(name, 0, Pins(pin, dir=way, conn=("gpio", 0)), _ATTRS)
            for name, (pin, way) in pins.items()
        ]
    )
    return made


@pytest.fixture(scope="module")
def bench(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[PinBench]:
    folder = tmp_path_factory.mktemp("clocks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ecp5_reference, "SETTLE_S", SETTLE_US * 1e-6)
        patch.setattr(ecp5_reference, "LOCK_S", LOCK_US * 1e-6)
        target = Target("camera", "ulx3s-85f", platform, ClockTop, {}, "ecp5")
        write_project(target, folder, constraints=False)
    made = PinBench(
        (folder / "top.v").read_text(),
        {"clk25_0__io": 1, "reference_0__io": 1, "wanted_0__io": 1},
        {"sync_out_0__io": 1},
    )
    yield made
    made.close()


def events(losses: bool) -> tuple[list[tuple[int, int]], list[int]]:
    """Levels of the inputs, and when the clock is to pause: changes or losses at any phase."""
    rng = np.random.default_rng(5)
    wanted, stopped, pauses = [], [], []
    for case in range(CASES):
        start = case * CASE_US * US + PRESENT_US * US
        end = start + (3 * SETTLE_US + LOCK_US) * US + int(rng.integers(200_000))
        wanted += [(start, 1), (end + (20 * US if losses else 0), 0)]
        if losses:
            stopped.append((end, end + 20 * US))
        pauses += [start, end]
    total = CASES * CASE_US * US
    changes = [(time, 0, -1) for time in range(HALF_OSCILLATOR_PS, total, HALF_OSCILLATOR_PS)]
    changes += [
        (time, 1, -1)
        for time in range(HALF_REFERENCE_PS + 1, total, HALF_REFERENCE_PS)
        if not any(first <= time < last for first, last in stopped)
    ]
    changes += [(time, 2, level) for time, level in wanted]
    word, made = 0, []
    for time, bit, level in sorted(changes):
        word = word ^ 1 << bit if level < 0 else word & ~(1 << bit) | level << bit
        made.append((time, word))
    return made, pauses


@pytest.mark.parametrize("losses", [False, True], ids=["changes", "losses"])
def test_the_clock_has_no_short_pulse_and_each_pause_is_one(bench: PinBench, losses: bool):
    inputs, pauses = events(losses)
    edges = np.array([time for time, _ in bench.run(inputs)])
    between = np.diff(edges)
    assert between.min() >= 0.99 * HALF_SYNC_PS
    bursts = np.split(edges, 1 + np.flatnonzero(between > US))
    # the model's gate closes with an edge: if its clock has stopped, with the first after the reset
    single = [burst for burst in bursts if len(burst) == 2]
    runs = [burst for burst in bursts if len(burst) > 2]
    assert len(single) <= (CASES if losses else 0)
    assert all(len(burst) > 1000 for burst in runs)
    # from one pause to the next; the first level is that at rest
    assert len(runs) == len(pauses) + 1
    stops = np.array([burst[-1] for burst in runs[:-1]])
    if losses:
        # noticed within 440 ns of the last change; a clock that stands still while high falls
        # with the reset, 18 clocks of the oscillator later
        bound = 440_000 + HALF_REFERENCE_PS + 2 * 18 * HALF_OSCILLATOR_PS
        assert (stops[1::2] - pauses[1::2] < bound).all()
    assert (stops >= pauses).all()
