# SPDX-License-Identifier: Apache-2.0
"""Schedules below one tick: what the lines are set to, and the error that the host states."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace

import pytest

from hueflight.devices import RequestError
from hueflight.devices.fine_delays import FineDelayError, FineDelays
from hueflight.devices.illuminator import Illuminator, open_illuminator
from hueflight.devices.pulse_schedule import (
    Capacity,
    ChannelLimit,
    ChannelPulse,
    PulseSchedule,
    ScheduleError,
    to_ticks,
)

from .conftest import PtyBoard, SoftwareIlluminator

TICK_NS, STEP_NS = 1.25, 0.025
LINES = FineDelays(128, STEP_NS, (0,) * 3, (0.0,) * 3)
CAPACITY = Capacity(3, 4, 4, 4, TICK_NS, (ChannelLimit(80, 80, 8),) * 3, LINES)
ODD = PulseSchedule(tuple((ChannelPulse(delay),) for delay in (0.0, 30.61, 60.33)), period_ns=320.0)


def aligned(schedule: PulseSchedule, lines: FineDelays) -> Capacity:
    """The board with its lines set for a schedule."""
    delays = [[pulse.delay_ns for pulse in pulses] for pulses in schedule.channels]
    return replace(CAPACITY, fine=lines.fitted(delays, TICK_NS))


@pytest.fixture
def line() -> Iterator[PtyBoard]:
    line = PtyBoard(SoftwareIlluminator(fine_steps=128))
    yield line
    line.close()


@pytest.fixture
def driver(line: PtyBoard) -> Iterator[Illuminator]:
    driver = open_illuminator(line.path, baud=3_000_000)
    yield driver
    driver.close()


def test_any_delay_to_half_a_step():
    seeded = random.Random(17)
    for _ in range(200):
        skew = tuple(seeded.uniform(-0.4, 1.5) for _ in range(3))
        starts = [seeded.uniform(0, 60) + 90 * k for k in range(3)]
        schedule = PulseSchedule(tuple((ChannelPulse(s),) for s in starts), period_ns=320)
        capacity = aligned(schedule, replace(LINES, skew_ns=skew))
        made = to_ticks(schedule, capacity)
        assert made.delay_error_ns <= STEP_NS / 2 + 1e-9
        assert capacity.fine is not None
        for channel, start in enumerate(starts):
            # what the pins do: ticks, line and skew, all later by the offset
            pin = made.channels[channel][0].delay * TICK_NS + skew[channel]
            pin += capacity.fine.settings[channel] * STEP_NS
            assert pin - capacity.fine.offset_ns == pytest.approx(start, abs=STEP_NS / 2 + 1e-9)
            assert made.in_ns.delays_ns[channel][0] == pytest.approx(start, abs=STEP_NS)


def test_several_pulses_of_a_channel_share_its_line():
    """Of 0.3 and 0.5 ns below a tick, the line is set between: the error that is left is told."""
    pulses = (ChannelPulse(10.3), ChannelPulse(100.5))
    schedule = PulseSchedule((pulses,), period_ns=320)
    capacity = aligned(schedule, LINES)
    assert capacity.fine is not None
    assert capacity.fine.settings == (16, 0, 0)
    assert to_ticks(schedule, capacity).delay_error_ns == pytest.approx(0.1)


def test_without_lines_the_error_is_that_of_ticks():
    made = to_ticks(ODD, replace(CAPACITY, fine=None))
    assert made.delay_error_ns == pytest.approx(0.61)  # 30.61 is 24 ticks and 0.61 ns
    assert made.late_ns == (0.0, 0.0, 0.0)


def test_a_measured_step_counts():
    lines = replace(LINES, step_ns=0.03)
    capacity = aligned(ODD, lines)
    assert capacity.fine is not None
    assert capacity.fine.settings == (0, 20, 11)  # 0.6 of 0.61 ns, and 0.33
    assert to_ticks(ODD, capacity).delay_error_ns == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"settings": (0, 128, 0)}, "channel 1: setting = 128: must be from 0 to 127"),
        ({"skew_ns": (0.0, 0.0)}, "skew_ns: 2 values, the board has 3 channels"),
        ({"skew_ns": (0.0, float("nan"), 0.0)}, "channel 1: skew_ns = nan: must be a number"),
        ({"step_ns": 0.0}, "step_ns = 0.0: must be a time"),
    ],
)
def test_fine_delays_that_do_not_exist(change: dict[str, object], said: str):
    with pytest.raises(FineDelayError, match=said):
        replace(LINES, **change)  # type: ignore[arg-type]


def test_the_driver_sets_lines_and_states_the_error(line: PtyBoard, driver: Illuminator):
    assert driver.capacity.fine == FineDelays(128, STEP_NS, (0,) * 9, (0.0,) * 9)
    assert driver.play(ODD).delay_error_ns == pytest.approx(0.61)
    lines = driver.align(ODD)
    assert [line.board.registers.get("fine_delay", k) for k in range(3)] == [0, 24, 13]
    assert lines.settings[:3] == (0, 24, 13)
    assert driver.play(ODD).delay_error_ns == pytest.approx(0.01)
    # a channel that fires 0.2 ns late is corrected, and all others are as late as it
    lines = driver.align(ODD, skew_ns=(0.2, *(0.0,) * 8))
    assert lines.offset_ns == pytest.approx(0.2)
    assert lines.settings[:2] == (0, 32)
    assert driver.play(ODD).delay_error_ns <= STEP_NS / 2
    again = Illuminator(driver.board.transport).capacity.fine
    assert again is not None
    assert again.settings == lines.settings


def test_lines_stay_while_the_board_is_armed(line: PtyBoard, driver: Illuminator):
    driver.align(ODD)
    before = driver.capacity
    driver.arm()
    with pytest.raises(RequestError, match="the board's state does not allow it now"):
        driver.align(PulseSchedule.even(3))
    assert driver.capacity == before
    assert line.board.registers.get("fine_delay", 1) == 24


def test_a_schedule_that_does_not_fit_is_refused_before_lines_move(
    line: PtyBoard, driver: Illuminator
):
    with pytest.raises(ScheduleError, match="10 channels: the board has 9"):
        driver.align(replace(ODD, channels=ODD.channels[:1] * 10))
    assert line.board.registers.get("fine_delay", 1) == 0


def test_a_build_without_lines():
    line = PtyBoard(SoftwareIlluminator())
    try:
        driver = open_illuminator(line.path, baud=3_000_000)
        assert driver.capacity.fine is None
        with pytest.raises(ScheduleError, match=r"without fine delay lines: build it with --set"):
            driver.align(ODD)
        driver.close()
    finally:
        line.close()
