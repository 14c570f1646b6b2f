# SPDX-License-Identifier: Apache-2.0
"""The whole generated top of boards: Table 1, and no LED stays on when the PLL loses lock."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.board import compile_board, run_board
from hueflight_protocol.control import Result
from hueflight_protocol.illuminator_map import ARM_KEY
from hueflight_protocol.wire import TEMPERATURE_UNKNOWN
from support.board_session import MAP, ULX3S, US, Board, Session, lit

FILES = Path(__file__).parents[1] / "boards" / "examples"


ECPIX5 = Board("ecpix5-85f", "ecp5", 100e6, 1250, 25 * 4)
# 12 MHz · 67 / 8 and two ticks a clock; input, pipeline and output have 2 + 19 + 1 clocks
HX8K = Board("hx8k", "ice40", 12e6, 4975, 22 * 2)
ARTY = Board(str(FILES / "arty-a7.toml"), "xc7", 100e6, 1250, 24 * 4)
NAMES = {"ids": lambda board: Path(board.name).stem}
BOARDS = pytest.mark.parametrize("board", [ULX3S, ECPIX5, HX8K, ARTY], **NAMES)
SUPERVISED = pytest.mark.parametrize("board", [ULX3S, ECPIX5, ARTY], **NAMES)
FAULT_BIT = 1 << 5

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # LUNA uses older records
]


@pytest.fixture(scope="module")
def compiled(verilator: None, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Board], Path]:
    """Function that compiles the illuminator of a board once."""
    programs: dict[Board, Path] = {}

    def make(board: Board) -> Path:
        if board not in programs:
            folder = tmp_path_factory.mktemp("board")
            write_project(find_target("illuminator", board.name), folder, constraints=False)
            programs[board] = compile_board(
                folder / "top.v", oscillator_hz=board.oscillator_hz, family=board.family
            )
        return programs[board]

    return make


@BOARDS
def test_table_1_at_every_phase_of_the_trigger(compiled: Callable[[Board], Path], board: Board):
    session = Session(board)
    session.load()
    session.write("arm", ARM_KEY)
    tick, latency = board.tick_ps, board.latency_ticks * board.tick_ps
    starts = []
    for phase in range(8):
        session.wait(4 * US + phase * tick)
        starts.append(session.trigger())
    session.wait(3 * US)
    run = run_board(compiled(board), session)
    assert [response.result for response in run.responses()] == [Result.OK] * session.requests
    for start in starts:
        (first, _), *_ = run.pulses(0, start, start + 2 * US)
        # sampled at the next tick; the pins have no delay of their own here
        assert latency - 4 * tick <= first - start <= latency + tick
        for channel in range(board.leds):
            assert run.pulses(channel, start, start + 2 * US) == [
                (first + 24 * tick * channel, 8 * tick)
            ]


@SUPERVISED
@pytest.mark.parametrize("mode", [1, 2], ids=["clock drifts on", "clock stops"])
def test_loss_of_lock_at_every_phase_of_a_pulse(
    compiled: Callable[[Board], Path], board: Board, mode: int
):
    """LEDs are off at once and stay off; the board is disarmed and reports the failure."""
    tick, latency = board.tick_ps, board.latency_ticks * board.tick_ps
    session = Session(board)
    session.load()
    losses, again, checks = [], [], []
    session.write("faults", 0xFFFF)
    session.write("arm", ARM_KEY)
    before_any = session.trigger()
    session.wait(2 * US)
    for step in range(-5, 11):
        session.write("arm", ARM_KEY)
        session.trigger()
        session.wait(latency - 8 * tick + step * tick)
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
        before = run.pulses(0, loss - 20 * tick, loss + 1)
        hit += any(start + width >= loss for start, width in before)
        assert all(width <= 8 * tick for _, width in before)
        # the model of the PLL notices within a half period of its output, or 1 ns
        assert not lit(run, loss + tick, trigger + 2 * US)
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
    assert abs((again_first - last) - (first - before_any)) <= tick
    for channel in range(board.leds):
        assert [width for _, width in run.pulses(channel, last, last + US)] == [8 * tick]


@BOARDS
def test_a_trigger_that_is_high_from_the_beginning_is_no_edge(
    compiled: Callable[[Board], Path], board: Board
):
    session = Session(board, trigger=1)
    none = session.read("triggers_seen")
    session.set("trigger", 0)
    session.wait(US)
    session.trigger()
    one = session.read("triggers_seen")
    responses = run_board(compiled(board), session).responses()
    assert responses[none].payload == (0,)
    assert responses[one].payload == (1,)


@SUPERVISED
def test_a_dead_oscillator_turns_the_leds_off(compiled: Callable[[Board], Path], board: Board):
    """The PLL's loss of lock, not a clock, releases the pins."""
    session = Session(board)
    session.load(width=72)
    session.write("arm", ARM_KEY)
    session.trigger()
    session.wait(board.tick_ps * (board.latency_ticks + 2))
    stopped = session.now_ps
    session.set("osc", 0)
    session.wait(50 * US)
    run = run_board(compiled(board), session)
    assert run.pulses(0, 0, stopped)
    assert not lit(run, stopped + US, run.end_ps)


def test_the_hx8k_is_disarmed_after_a_loss_of_lock_but_needs_a_clock(
    compiled: Callable[[Board], Path],
):
    """What docs/illuminator.md states of a board without supervision, in both directions."""
    tick, latency = HX8K.tick_ps, HX8K.latency_ticks * HX8K.tick_ps
    for mode in (1, 2):
        session = Session(HX8K)
        session.load()
        session.write("arm", ARM_KEY)
        session.trigger()
        session.wait(latency - 4 * tick)
        lost = session.now_ps
        session.set("pll", mode)
        session.wait(20 * US)
        again = session.now_ps
        session.set("pll", 0)
        session.wait(40 * US)
        state = session.read("state")
        run = run_board(compiled(HX8K), session)
        assert lit(run, lost - 4 * tick, lost + 1)
        # the next clocks turn the LED off; without them its pin keeps its level
        assert lit(run, again - US, again) == (mode == 2)
        assert not lit(run, again + 30 * US, again + 40 * US)
        assert not run.responses()[state].payload[0] & 1, "armed after the failure"


@pytest.mark.parametrize("board", [ULX3S, ECPIX5], **NAMES)
def test_the_temperature_is_that_of_the_sensor(compiled: Callable[[Board], Path], board: Board):
    session = Session(board)
    early = session.read("temperature")
    features = session.read("features")
    session.wait(11_000 * US)
    late = session.read("temperature")
    answers = run_board(compiled(board), session).responses()
    assert MAP["features"].decode(answers[features].payload[0])["temperature"]
    told = [MAP["temperature"].decode(answers[at].payload[0])["value"] for at in (early, late)]
    assert told == [TEMPERATURE_UNKNOWN, 70_000]
