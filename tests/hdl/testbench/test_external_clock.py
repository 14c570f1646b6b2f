# SPDX-License-Identifier: Apache-2.0
"""A whole ULX3S that runs from an external clock, and what happens when that fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from hueflight_hdl.boards import ecp5_reference
from hueflight_hdl.boards.target import Options
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.board import compile_board, run_board
from hueflight_protocol.control import Result
from hueflight_protocol.illuminator_map import ARM_KEY
from support.board_session import ULX3S, US, Session, lit

REFERENCE_HZ = 10_000_000
HALF_PS = 50_000
OSCILLATOR_PS = 40_000
SETTLE_US = 200  # instead of the data sheet's millisecond: fewer clocks are simulated
LOCK_US = 100
PRESENT_US = 120  # two windows of 256 changes, each of two periods
SWITCH_US = 3 * SETTLE_US + 60  # answer, reset, reset again, lock
TICK, LATENCY = ULX3S.tick_ps, ULX3S.latency_ticks * ULX3S.tick_ps
EXTERNAL, PRESENT, LOST = 1, 2, 4
CLOCK_FAILED, REFERENCE_LOST = 1 << 5, 1 << 6

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def program(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The board, compiled once."""
    folder = tmp_path_factory.mktemp("board")
    options = Options(settings={"reference_hz": REFERENCE_HZ})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ecp5_reference, "SETTLE_S", SETTLE_US * 1e-6)
        patch.setattr(ecp5_reference, "LOCK_S", LOCK_US * 1e-6)
        target = find_target("illuminator", ULX3S.name, options)
        write_project(target, folder, constraints=False)
    return compile_board(folder / "top.v", oscillator_hz=ULX3S.oscillator_hz)


def choose(session: Session) -> None:
    """Have the board run from the external clock."""
    session.write("clock_source", 0)
    session.write("clock_source", 1)
    session.wait(SWITCH_US * US)


def test_trains_on_the_external_clock_and_back(program: Path):
    """Ticks follow the external clock; each change of the clock disarms the board."""
    session = Session(ULX3S)
    session.load()
    absent = session.read("clock_state")
    session.write("clock_source", 1)  # nothing is there: refused
    session.wait(SWITCH_US * US)
    refused = session.read("clock_state")
    session.set("period", 0)
    session.set("reference", HALF_PS * 101 // 100)  # 1 % too slow: within the tolerance
    session.wait(PRESENT_US * US)
    late = session.read("clock_state")  # it must be asked for again
    session.write("arm", ARM_KEY)
    choose(session)
    chosen = session.read("clock_state")
    state = session.read("state", 2)
    session.set("period", 0)
    session.write("faults", CLOCK_FAILED)
    session.write("arm", ARM_KEY)
    external = session.trigger()
    session.wait(2 * US)
    session.write("clock_source", 0)
    session.wait(SWITCH_US * US)
    internal_state = session.read("clock_state")
    disarmed = session.read("state")
    session.write("arm", ARM_KEY)
    internal = session.trigger()
    session.wait(2 * US)
    session.set("period", 0)
    run = run_board(program, session)

    responses = run.responses()
    assert [response.result for response in responses] == [Result.OK] * session.requests
    assert responses[absent].payload == responses[refused].payload == (0,)
    assert responses[late].payload == (PRESENT,)
    assert responses[chosen].payload == (PRESENT | EXTERNAL,)
    assert not responses[state].payload[0] & 1, "armed after the change"
    assert responses[state].payload[1] & CLOCK_FAILED
    assert not responses[state].payload[1] & REFERENCE_LOST
    assert responses[internal_state].payload == (PRESENT,)
    assert not responses[disarmed].payload[0] & 1
    # the clock output is the oscillator, then the external clock at the oscillator's frequency
    periods = [period for _, period in run.periods]
    assert periods[0] == periods[2] == OSCILLATOR_PS
    assert periods[1] == pytest.approx(OSCILLATOR_PS * 1.01, rel=1e-3)
    # and so are the ticks: nine pulses of 8 ticks, 24 apart, on either clock
    for trigger, scale in ((external, 1.01), (internal, 1.0)):
        (first, _), *_ = run.pulses(0, trigger, trigger + 2 * US)
        for channel in range(ULX3S.leds):
            ((start, width),) = run.pulses(channel, trigger, trigger + 2 * US)
            assert start - first == pytest.approx(24 * TICK * channel * scale, rel=2e-3, abs=10)
            assert width == pytest.approx(8 * TICK * scale, rel=2e-3)


def test_the_external_clock_is_lost_at_every_phase_of_a_pulse(program: Path):
    """No LED is on for longer than it should be, and the board goes on alone, disarmed."""
    session = Session(ULX3S)
    session.load()
    losses, ends, checks = [], [], []
    session.set("reference", HALF_PS)
    session.wait(PRESENT_US * US)
    # the PLLs go on for 200 to 440 ns without their clock, 160 to 352 ticks: trains of 200 ticks
    # that begin 133 to 157 ticks after the loss are under way then, at 16 of the 24 ticks of a
    # pulse and its pause
    for step in range(16):
        choose(session)
        session.write("faults", CLOCK_FAILED | REFERENCE_LOST)
        session.write("arm", ARM_KEY)
        losses.append(session.now_ps)
        session.set("reference", 0)
        session.wait(TICK * (133 + 5 * step % 24) - LATENCY)
        session.trigger()
        session.wait(SWITCH_US * US)
        ends.append(session.trigger())
        session.wait(2 * US)
        checks.append((session.read("state", 2), session.read("clock_state")))
        session.set("reference", HALF_PS)
        session.wait(PRESENT_US * US)
    returned = session.read("clock_state")
    session.write("arm", ARM_KEY)
    last = session.trigger()
    session.wait(2 * US)
    run = run_board(program, session)

    responses = run.responses()
    assert [response.result for response in responses] == [Result.OK] * session.requests
    cut = 0
    for loss, end in zip(losses, ends, strict=True):
        for channel in range(ULX3S.leds):
            widths = [width for _, width in run.pulses(channel, loss - US, end + 2 * US)]
            assert all(width <= 8 * TICK for width in widths)
            cut += any(width < 8 * TICK for width in widths)
        # 440 ns of detection, and what the flip-flops around it take
        assert not lit(run, loss + 600_000, end + 2 * US)
    assert cut >= 2  # pulses were under way when the board let go of the pins
    for state, clock in checks:
        armed, faults = responses[state].payload
        assert not armed & 1, "armed after the loss"
        assert faults & CLOCK_FAILED
        assert faults & REFERENCE_LOST
        assert responses[clock].payload == (LOST,)
    # it has come back, but nobody has asked for it
    assert responses[returned].payload == (PRESENT | LOST,)
    for channel in range(ULX3S.leds):
        assert [width for _, width in run.pulses(channel, last, last + US)] == [8 * TICK]


def test_a_clock_to_which_the_pll_does_not_lock_is_given_up(program: Path):
    """1 % too fast, the PLL's oscillator would have to run at 808 MHz, out of its range."""
    session = Session(ULX3S)
    session.set("reference", HALF_PS * 99 // 100)
    session.wait(PRESENT_US * US)
    choose(session)
    session.wait((LOCK_US + SWITCH_US) * US)
    clock, faults = session.read("clock_state"), session.read("faults")
    responses = run_board(program, session).responses()
    assert responses[clock].payload == (PRESENT | LOST,)
    assert responses[faults].payload[0] & REFERENCE_LOST


def test_a_clock_of_a_wrong_frequency_is_refused(program: Path):
    session = Session(ULX3S)
    states = []
    for percent in (90, 97, 103, 110):
        session.set("reference", HALF_PS * percent // 100)
        session.wait(PRESENT_US * US)
        choose(session)
        states.append(session.read("clock_state"))
    responses = run_board(program, session).responses()
    assert [responses[state].payload for state in states] == [(0,)] * 4
