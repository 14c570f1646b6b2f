# SPDX-License-Identifier: Apache-2.0
"""Supervision of an external clock, against what its frequency and its edges are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from hueflight_hdl.boards.ecp5_camera import camera_target
from hueflight_hdl.boards.ecp5_reference import conversion
from hueflight_hdl.boards.reference_clock import (
    SHORTEST_HALF,
    WINDOW_EDGES,
    ReferenceSupervisor,
    divider_bits,
)
from hueflight_hdl.boards.target import Options, TargetError
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.boards.ulx3s import Ft601Camera
from hueflight_hdl.testbench.cxxrtl import Simulation, simulate

INTERVAL, SETTLE, PATIENCE = 5.0, 30, 200
WINDOW = round(WINDOW_EDGES * INTERVAL)
BOUND = 9  # clocks; two more are those of the synchronizer, which the testbench leaves out


@pytest.fixture
def supervisor(simulator: None) -> Iterator[Simulation]:
    with simulate(ReferenceSupervisor(interval=INTERVAL, settle=SETTLE, patience=PATIENCE)) as made:
        yield made


def levels(clocks: int, interval: float, *, jitter: float = 0.0, seed: int = 1) -> np.ndarray:
    """A divided clock as it is sampled: changes every `interval` clocks, each off by a jitter."""
    count = int(clocks / interval) + 2
    random = np.random.default_rng(seed)
    changes = np.arange(count) * interval + random.uniform(-jitter, jitter, count)
    return (np.searchsorted(changes, np.arange(clocks), side="right") % 2).astype(np.uint8)


def run(
    supervisor: Simulation,
    divided: np.ndarray,
    wanted: np.ndarray | int,
    locked: np.ndarray | int = 1,
) -> np.ndarray:
    inputs = supervisor.inputs(len(divided))
    inputs["divided"] = divided
    inputs["wanted"] = wanted
    inputs["locked"] = locked
    return supervisor.run(inputs)


@pytest.mark.parametrize(
    ("interval", "jitter", "present"),
    [(5.0, 0.0, 1), (5.0, 0.4, 1), (5.05, 0.0, 1), (4.95, 0.3, 1), (5.15, 0.0, 0), (4.85, 0.0, 0)],
)
def test_a_clock_is_present_within_its_tolerance(
    supervisor: Simulation, interval: float, jitter: float, present: int
):
    """1/64 is 1.6 %: 1 % is within, 3 % is not; a single change may be off by half a clock."""
    outputs = run(supervisor, levels(6 * WINDOW, interval, jitter=jitter), 0)
    assert (outputs["present"][3 * WINDOW :] == present).all()
    assert not outputs["select"].any()
    assert not outputs["hold"].any()


def test_it_must_be_there_when_it_is_asked_for(supervisor: Simulation):
    quiet = np.zeros(WINDOW, np.uint8)
    assert not run(supervisor, quiet, 1)["hold"].any()
    later = run(supervisor, levels(4 * WINDOW, INTERVAL), 1)
    assert later["present"][-1]
    assert not later["hold"].any()


def test_the_source_changes_in_the_middle_of_a_reset(supervisor: Simulation):
    divided = levels(6 * WINDOW, INTERVAL)
    wanted = np.zeros(len(divided), np.uint8)
    wanted[3 * WINDOW : 5 * WINDOW] = 1
    outputs = run(supervisor, divided, wanted)
    held = np.flatnonzero(np.diff(outputs["hold"].astype(int)))
    chosen = np.flatnonzero(np.diff(outputs["select"].astype(int)))
    assert len(held) == 4
    assert len(chosen) == 2
    for asked, start, change, stop in zip(
        (3 * WINDOW, 5 * WINDOW), held[::2], chosen, held[1::2], strict=True
    ):
        assert start - asked >= SETTLE  # the answer to the request goes out first
        assert change - start >= SETTLE
        assert stop - change >= SETTLE
    assert not outputs["lost"].any()


@pytest.mark.parametrize("phase", range(5))
@pytest.mark.parametrize("wish", [1, 0], ids=["wanted", "given up just before"])
def test_a_lost_clock_is_noticed_at_once_and_not_used_again(
    supervisor: Simulation, phase: int, wish: int
):
    """Within 9 clocks of the last change, or 440 ns at 25 MHz with the synchronizer in front."""
    wanted = np.zeros(7 * WINDOW, np.uint8)
    stop = 5 * WINDOW + phase
    wanted[3 * WINDOW :] = 1
    if not wish:
        wanted[stop - 3 :] = 0
    divided = levels(len(wanted), INTERVAL)
    divided[stop:] = divided[stop]
    last = 1 + np.flatnonzero(np.diff(divided.astype(int)))[-1]
    outputs = run(supervisor, divided, wanted)
    assert outputs["select"][stop]
    assert not outputs["hold"][stop]
    assert outputs["hold"][last + BOUND]
    assert outputs["lost"][last + BOUND :].all()
    assert not outputs["select"][-1]
    assert not outputs["hold"][-1]
    # it comes back: present, but not in use until it is asked for again
    back = run(supervisor, levels(3 * WINDOW, INTERVAL), wish)
    assert back["present"][-1]
    assert back["lost"].all()
    assert not back["hold"].any()
    run(supervisor, levels(10, INTERVAL), 0)
    again = run(supervisor, levels(3 * WINDOW, INTERVAL), 1)
    assert again["select"][-1]
    assert not again["lost"][-1]


@pytest.mark.parametrize("late", [0, 1])
def test_a_clock_to_which_the_pll_does_not_lock_is_given_up(supervisor: Simulation, late: int):
    """So the board can be reached again, whatever is wrong with that clock."""
    divided = levels(6 * WINDOW, INTERVAL)
    wanted = np.zeros(len(divided), np.uint8)
    wanted[3 * WINDOW :] = 1
    chosen = 3 * WINDOW + 3 * SETTLE + 5  # the answer, and twice the reset
    locked = np.ones(len(divided), np.uint8)
    locked[3 * WINDOW + SETTLE : chosen + PATIENCE - 20 + 40 * late] = 0
    outputs = run(supervisor, divided, wanted, locked)
    assert outputs["select"][chosen + PATIENCE - 10]
    assert outputs["select"][-1] == (not late)
    assert outputs["lost"][-1] == late
    assert not outputs["hold"][-1]


@pytest.mark.parametrize("clock", [12e6, 25e6, 100e6])
@pytest.mark.parametrize("reference", [10e6, 25e6, 100e6])
def test_no_change_is_missed_by_sampling(clock: float, reference: float):
    half = (1 << (divider_bits(clock, reference) - 1)) * clock / reference
    assert half >= SHORTEST_HALF
    assert divider_bits(clock, reference) == 1 or half < 2 * SHORTEST_HALF


def test_the_pll_that_converts_is_within_its_range():
    """Multiples of both frequencies; the oscillator of the PLL runs from 400 to 800 MHz."""
    assert conversion(25_000_000, 10_000_000) == (50_000_000, 400_000_000)
    assert conversion(100_000_000, 10_000_000) == (100_000_000, 400_000_000)
    for clock, reference in ((25_000_000, 25_000_000), (12_000_000, 10_000_000)):
        feedback, vco = conversion(clock, reference)
        assert feedback % clock == feedback % reference == vco % feedback == 0
        assert 400e6 <= vco <= 800e6


@pytest.mark.parametrize(
    ("design", "board", "hz", "said"),
    [
        ("illuminator", "ulx3s-85f", 8_000_000, "reference_hz = 8000000: must be from 10000000"),
        ("illuminator", "ulx3s-85f", 10_000_001, "a common multiple of at most 8e.08 Hz with"),
        ("illuminator", "hx8k", 10_000_000, "hx8k cannot run from an external clock"),
        ("camera", "ecpix5-85f", 10_000_001, "a common multiple of at most 8e.08 Hz with"),
        ("camera", "xem6310", 10_000_000, "xem6310 cannot run from an external clock"),
    ],
)
def test_clocks_that_cannot_be_used(design: str, board: str, hz: int, said: str):
    with pytest.raises(TargetError, match=said):
        find_target(design, board, Options(settings={"reference_hz": hz}))


def test_a_camera_needs_both_pins():
    options = Options(settings={"reference_hz": 10_000_000})
    with pytest.raises(TargetError, match="with pins named reference and time_sync, can"):
        camera_target("bare", ULX3S_85F_Platform, Ft601Camera, options, link_mhz={})


@pytest.mark.parametrize(
    ("design", "its_own"),
    [("illuminator", set()), ("camera", {"clock_failures", "time_sync", "time_state"})],
)
def test_the_registers_are_there_only_with_an_external_clock(design: str, its_own: set[str]):
    plain = find_target(design, "ulx3s-85f").registers
    with_clock = find_target(
        design, "ulx3s-85f", Options(settings={"reference_hz": 25_000_000})
    ).registers
    assert plain is not None
    assert with_clock is not None
    more = {register.name for register in with_clock} - {register.name for register in plain}
    assert more == {"clock_source", "clock_state", "reference_hz"} | its_own
    assert with_clock["reference_hz"].reset == 25_000_000
    assert plain.fingerprint != with_clock.fingerprint
