# SPDX-License-Identifier: Apache-2.0
"""A whole ULX3S with fine delay lines: edges of the LEDs' pins in picoseconds."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from hueflight.devices.fine_delays import FineDelays
from hueflight.devices.pulse_schedule import (
    Capacity,
    ChannelLimit,
    ChannelPulse,
    PulseSchedule,
    TickSchedule,
    to_ticks,
)
from hueflight_hdl.boards.target import Options
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.board import BoardRun, compile_board, run_board
from hueflight_protocol import control
from hueflight_protocol.control import Result
from hueflight_protocol.illuminator_map import ARM_KEY
from support.board_session import MAP, ULX3S, US, Session

TOLERANCE_PS = 30
TICK_NS = ULX3S.tick_ps / 1000
LEDS = ULX3S.leds

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def program(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The board, compiled once."""
    folder = tmp_path_factory.mktemp("board")
    target = find_target("illuminator", ULX3S.name, Options(settings={"fine_delay": 1}))
    write_project(target, folder, constraints=False)
    return compile_board(folder / "top.v", oscillator_hz=ULX3S.oscillator_hz)


def any_schedule(seed: int) -> PulseSchedule:
    """A pulse of each LED at any time; LED 0 fires with the trigger, as the reference."""
    seeded = random.Random(seed)
    delays = [0.0, *(30.0 * k + seeded.uniform(0, 18) for k in range(1, LEDS))]
    return PulseSchedule(tuple((ChannelPulse(delay),) for delay in delays), period_ns=320.0)


def load(session: Session, schedule: PulseSchedule) -> tuple[TickSchedule, int]:
    """Write a schedule and the fine delays for it, as the driver does."""
    lines = FineDelays(128, 0.025, (0,) * LEDS, (0.0,) * LEDS)
    lines = lines.fitted([[p.delay_ns for p in pulses] for pulses in schedule.channels], TICK_NS)
    capacity = Capacity(LEDS, 4, 32, 4, TICK_NS, (ChannelLimit(80, 80, 8),) * LEDS, lines)
    made = to_ticks(schedule, capacity)
    written = session.write("fine_delay", *lines.settings)
    for channel, (pulse,) in enumerate(made.channels):
        word = pulse.delay | pulse.width << 16
        address = MAP["pulse"].address_of(0, channel, 0)
        session.request(control.write(session.requests, address, [word]))
    session.write("bank_enable", (1 << LEDS) - 1)
    return made, written


def check_edges(run: BoardRun, at: int, schedule: PulseSchedule) -> int:
    """Compare the edges of a train with what was asked; return the largest error in ps."""
    (zero, _), *_ = run.pulses(0, at, at + 2 * US)
    worst = 0
    for channel, (pulse,) in enumerate(schedule.channels):
        ((start, width),) = run.pulses(channel, at, at + 2 * US)
        worst = max(worst, abs(start - zero - round(pulse.delay_ns * 1000)))
        assert width == round(pulse.width_ns * 1000)  # a line delays both edges
    assert worst <= TOLERANCE_PS
    return worst


def test_edges_within_30_ps_and_lines_that_stay(program: Path):
    first, second = any_schedule(1), any_schedule(2)
    session = Session(ULX3S)
    made, _ = load(session, first)
    session.write("arm", ARM_KEY)
    trains = [(session.trigger(), first)]
    session.wait(3 * US)
    refused = session.write("fine_delay", *(0,) * LEDS)
    kept = session.read("fine_delay", LEDS)
    trains.append((session.trigger(), first))
    session.wait(3 * US)
    session.set("pll", 2)  # lines are set anew after a failure of the clock
    session.wait(5 * US)
    session.set("pll", 0)
    session.wait(10 * US)
    session.write("arm", ARM_KEY)
    trains.append((session.trigger(), first))
    session.wait(3 * US)
    session.write("arm", 0)
    remade, _ = load(session, second)
    session.write("arm", ARM_KEY)
    trains.append((session.trigger(), second))
    session.wait(3 * US)
    run = run_board(program, session)

    responses = run.responses()
    results = [response.result for response in responses]
    assert results.pop(refused) == Result.REFUSED
    assert results == [Result.OK] * (session.requests - 1)
    assert any(responses[kept].payload), "the lines were reset although the board is armed"
    for at, schedule in trains:
        check_edges(run, at, schedule)
    # what the host says is left is what is left, in whole picoseconds
    for result, (at, schedule) in ((made, trains[0]), (remade, trains[-1])):
        assert check_edges(run, at, schedule) == pytest.approx(result.delay_error_ns * 1000, abs=1)
