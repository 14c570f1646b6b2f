# SPDX-License-Identifier: Apache-2.0
"""The whole generated top of ECP5 boards: Table 1, and no LED stays on when the PLL loses lock."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.board import BoardRun, BoardScript, compile_board, run_board
from hueflight_protocol import control
from hueflight_protocol.control import Result
from hueflight_protocol.illuminator_map import ARM_KEY, illuminator_map

OSCILLATORS_HZ = {"ulx3s-85f": 25e6, "ecpix5-85f": 100e6}
US = 1_000_000  # in picoseconds
TICK = 1250
LATENCY = 24 * 4 * TICK  # docs/illuminator.md: 24 clocks of four ticks
MAP = illuminator_map()
BOARDS = pytest.mark.parametrize("board", ["ulx3s-85f", "ecpix5-85f"])
FAULT_BIT = 1 << 5

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # LUNA uses older records
]


@pytest.fixture(scope="module")
def compiled(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Function that compiles the illuminator of a board once."""
    programs: dict[str, Path] = {}

    def make(board: str) -> Path:
        if board not in programs:
            folder = tmp_path_factory.mktemp(board)
            write_project(find_target("illuminator", board), folder, constraints=False)
            programs[board] = compile_board(folder / "top.v", oscillator_hz=OSCILLATORS_HZ[board])
        return programs[board]

    return make


class Session(BoardScript):
    """A script with numbered requests; each waits for its response."""

    def __init__(self, *, trigger: int = 0) -> None:
        super().__init__()
        self.requests = 0
        self.set("trigger", trigger)
        self.wait(20 * US)  # the PLL locks

    def request(self, request: control.Request) -> int:
        """Send a request; return its place among the responses."""
        self.send(control.serial_frame(control.encode_request(request)))
        self.wait(180 * US)
        self.requests += 1
        return self.requests - 1

    def write(self, name: str, *words: int) -> int:
        return self.request(control.write(self.requests, MAP[name].address, words))

    def read(self, name: str, count: int = 1) -> int:
        return self.request(control.read(self.requests, MAP[name].address, count))

    def load(self, *, width: int = 8) -> None:
        """Load Table 1: nine pulses, 24 ticks apart, with another width."""
        words = [0] * 36
        for channel in range(9):
            words[4 * channel] = 24 * channel | width << 16
        self.write("pulse", *words)
        self.write("bank_enable", 0x1FF)

    def trigger(self) -> int:
        """Send a trigger; return its time."""
        at = self.now_ps
        self.set("trigger", 1)
        self.wait(TICK * 8)
        self.set("trigger", 0)
        return at


def lit(run: BoardRun, start: int, stop: int) -> bool:
    """Whether any LED is on within a window."""
    before = [levels for time, levels in run.led if time <= start]
    return bool(before[-1]) or any(levels for time, levels in run.led if start < time < stop)


@BOARDS
def test_table_1_at_every_phase_of_the_trigger(compiled: Callable[[str], Path], board: str):
    session = Session()
    session.load()
    session.write("arm", ARM_KEY)
    starts = []
    for phase in range(8):
        session.wait(3 * US + phase * TICK)
        starts.append(session.trigger())
    session.wait(3 * US)
    run = run_board(compiled(board), session)
    assert [response.result for response in run.responses()] == [Result.OK] * session.requests
    for start in starts:
        (first, _), *_ = run.pulses(0, start, start + US)
        # sampled at the next edge of 800 MHz; the pins have no delay of their own here
        assert LATENCY - 4 * TICK <= first - start <= LATENCY + TICK
        for channel in range(9):
            assert run.pulses(channel, start, start + US) == [
                (first + 24 * TICK * channel, 8 * TICK)
            ]


@BOARDS
@pytest.mark.parametrize("mode", [1, 2], ids=["clock drifts on", "clock stops"])
def test_loss_of_lock_at_every_phase_of_a_pulse(
    compiled: Callable[[str], Path], board: str, mode: int
):
    """LEDs are off at once and stay off; the board is disarmed and reports the failure."""
    session = Session()
    session.load()
    losses, again, checks = [], [], []
    session.write("faults", 0xFFFF)
    session.write("arm", ARM_KEY)
    before_any = session.trigger()
    session.wait(2 * US)
    for step in range(-5, 11):
        session.write("arm", ARM_KEY)
        session.trigger()
        session.wait(LATENCY - 8 * TICK + step * TICK)
        losses.append(session.now_ps)
        session.set("pll", mode)
        session.wait(5 * US)
        session.set("pll", 0)
        session.wait(10 * US)
        again.append(session.trigger())
        session.wait(2 * US)
        checks.append(session.read("state", 2))
        session.write("faults", FAULT_BIT)
    count = session.read("clock_failures")
    cleared = session.read("faults")
    session.write("arm", ARM_KEY)
    last = session.trigger()
    session.wait(2 * US)
    run = run_board(compiled(board), session)

    hit = 0
    for loss, trigger in zip(losses, again, strict=True):
        before = run.pulses(0, loss - 20 * TICK, loss + 1)
        hit += any(start + width >= loss for start, width in before)
        assert all(width <= 8 * TICK for _, width in before)
        # the model of the PLL notices within a half period of its output, or 1 ns
        assert not lit(run, loss + TICK, trigger + 2 * US)
    assert hit >= 8  # of the eight ticks of the pulse, each was cut
    responses = run.responses()
    assert [response.result for response in responses] == [Result.OK] * session.requests
    for check in checks:
        state, faults = responses[check].payload
        assert not state & 1, "armed after the failure"
        assert faults & FAULT_BIT
    assert responses[count].payload == (len(losses),)
    assert not responses[cleared].payload[0] & FAULT_BIT
    # armed again, it fires as before, and as late: no I/O register starts half a clock off
    (first, _), *_ = run.pulses(0, before_any, before_any + US)
    (again_first, _), *_ = run.pulses(0, last, last + US)
    assert abs((again_first - last) - (first - before_any)) <= TICK
    for channel in range(9):
        assert [width for _, width in run.pulses(channel, last, last + US)] == [8 * TICK]


@BOARDS
def test_a_trigger_that_is_high_from_the_beginning_is_no_edge(
    compiled: Callable[[str], Path], board: str
):
    session = Session(trigger=1)
    none = session.read("triggers_seen")
    session.set("trigger", 0)
    session.wait(US)
    session.trigger()
    one = session.read("triggers_seen")
    responses = run_board(compiled(board), session).responses()
    assert responses[none].payload == (0,)
    assert responses[one].payload == (1,)


@BOARDS
def test_a_dead_oscillator_turns_the_leds_off(compiled: Callable[[str], Path], board: str):
    """The PLL's loss of lock, not a clock, releases the pins."""
    session = Session()
    session.load(width=72)
    session.write("arm", ARM_KEY)
    session.trigger()
    session.wait(LATENCY - 8 * TICK + 10 * TICK)
    stopped = session.now_ps
    session.set("osc", 0)
    session.wait(50 * US)
    run = run_board(compiled(board), session)
    assert run.pulses(0, 0, stopped)
    assert not lit(run, stopped + US, run.end_ps)
