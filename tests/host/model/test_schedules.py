# SPDX-License-Identifier: Apache-2.0
"""Schedules: how far they range by closed forms and by brute force, and the designer's promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hueflight as hf
from hueflight.errors import InstrumentError
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.schedules import Schedule, ambiguity, design_schedules, unambiguous_range

HALF_LIGHT = SPEED_OF_LIGHT_M_PER_NS / 2
WHOLE = 320 * HALF_LIGHT
FIRST = Schedule.once((18.75, 65, 247.5, 305, 100, 168.75, 280, 220, 125), 320.0)
SECOND = Schedule.once((55, 178.75, 132.5, 275, 26.25, 312.5, 218.75, 80, 250), 320.0)


def test_even_train_repeats_at_its_spacing():
    # nine pulses 30 ns apart: at a shift of n spacings 9 − n find a partner, across the gap of
    # 80 ns others do
    even = Schedule.of(hf.Instrument.load("paper"))
    for colours in range(1, 9):
        reached = unambiguous_range(even, colours=colours, resolution_ns=0.1)
        assert reached == pytest.approx(30 * HALF_LIGHT, abs=0.1 * HALF_LIGHT)
    assert unambiguous_range(even, colours=9) == pytest.approx(WHOLE)
    shifts_ns, partners = ambiguity(even, resolution_ns=0.5)
    for spacings in range(6):
        at = np.argmin(np.abs(shifts_ns - 30 * spacings))
        assert partners[at] == 9 - spacings


def test_two_that_take_turns_range_the_whole_circle_for_one_colour():
    assert unambiguous_range(FIRST, colours=1) == pytest.approx(25 * HALF_LIGHT, rel=0.05)
    assert unambiguous_range(SECOND, colours=1) == pytest.approx(25 * HALF_LIGHT, rel=0.05)
    assert unambiguous_range(FIRST, SECOND, colours=1) == pytest.approx(WHOLE)
    # the same schedule twice tells nothing more
    assert unambiguous_range(FIRST, FIRST) == unambiguous_range(FIRST)


def test_two_pulses_for_each_led_tell_one_colour_too():
    coded = Schedule(((0.0, 30.0), (60.0, 110.0), (150.0, 230.0)), 320.0)
    assert unambiguous_range(coded, colours=1) == pytest.approx(WHOLE)
    # gaps of 30 and 290 against 290 and 30: a shift of 160 exchanges the bands
    exchanged = Schedule(((0.0, 30.0), (160.0, 190.0)), 320.0)
    assert unambiguous_range(exchanged, colours=1, resolution_ns=0.1) == pytest.approx(
        160 * HALF_LIGHT, rel=1e-2
    )


@settings(max_examples=30)
@given(
    st.lists(st.integers(0, 63), min_size=2, max_size=6, unique=True), st.integers(1, 3),
)  # fmt: skip
def test_against_brute_force(places, colours):
    """On a circle of 64 places: shift everything, count which pulses land on pulses."""
    schedule = Schedule.once([5.0 * place for place in places], 320.0)
    confused = [
        min(shift, 64 - shift)
        for shift in range(1, 64)
        if sum((place + shift) % 64 in places for place in places) >= colours
    ]
    expected = 5.0 * min(confused, default=64)
    reached = unambiguous_range(schedule, colours=colours, resolution_ns=1.0)
    assert reached == pytest.approx(expected * HALF_LIGHT, abs=1.0 * HALF_LIGHT)


@pytest.mark.parametrize("seed", [0, 1])
def test_designed_pair_ranges_the_whole_circle(seed):
    pair = design_schedules(9, period_ns=320.0, seed=seed)
    assert unambiguous_range(*pair, colours=1, resolution_ns=2.0) == pytest.approx(WHOLE)
    for schedule in pair:
        places = np.sort([delays[0] for delays in schedule.delays_ns])
        assert np.diff(np.append(places, places[0] + 320)).min() >= 25
        np.testing.assert_array_equal(places % 1.25, 0)
        # each alone serves two colours
        assert unambiguous_range(schedule, colours=2) == pytest.approx(WHOLE)


def test_designed_for_three_bands_and_a_short_period():
    (one,) = design_schedules(3, period_ns=90.0, schedules=1, range_m=13.0)
    assert unambiguous_range(one, colours=2) >= 13.0
    assert one.period_ns == 90.0


def test_applied_to_an_instrument():
    instrument = hf.Instrument.load("paper")
    changed = FIRST.applied_to(instrument)
    assert Schedule.of(changed) == FIRST
    assert all("].delay_ns: " in line for line in instrument.differences(changed))
    coded = Schedule(tuple((delay, delay + 30.0) for delay in range(9)), 320.0)
    assert Schedule.of(coded.applied_to(instrument)) == coded


def test_bad_calls():
    with pytest.raises(InstrumentError, match="band 1 fires at"):
        Schedule(((0.0,), (320.0,)), 320.0)
    with pytest.raises(InstrumentError, match="can't be interleaved"):
        unambiguous_range(FIRST, Schedule.once((0.0, 30.0), 320.0))
    with pytest.raises(InstrumentError, match="resolution_ns = 0"):
        unambiguous_range(FIRST, resolution_ns=0.0)
    with pytest.raises(InstrumentError, match=r"9 bands with 40 ns.*it holds 8"):
        design_schedules(9, period_ns=320.0, gap_ns=40)
    with pytest.raises(InstrumentError, match=r"repeats after 47\.97 m"):
        design_schedules(9, period_ns=320.0, range_m=60)
    with pytest.raises(InstrumentError, match="for 9 bands, instrument"):
        FIRST.applied_to(
            hf.Instrument.load("paper").replace(bands=hf.Instrument.load("paper").bands[:3])
        )
    with pytest.raises(InstrumentError, match="no schedule of 9 bands"):
        # 72 differences, each at least 10 ns from the next, don't fit 320 ns
        design_schedules(9, period_ns=320.0, schedules=1, resolution_ns=10)
