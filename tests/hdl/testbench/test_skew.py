# SPDX-License-Identifier: Apache-2.0
"""A whole ULX3S whose outputs are led to its trigger: the driver finds step and skew."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hueflight.devices.illuminator import Illuminator
from hueflight.devices.skew import measure_skew
from hueflight_hdl.boards.target import Options
from hueflight_hdl.boards.targets import find_target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.board import BoardProcess, BoardScript, compile_board
from support.board_session import ULX3S, US

WIRE_PS = {0: 3120, 8: 4795}
STEP_NS = 0.025  #: of the model, and of the board as its documents have it

pytestmark = pytest.mark.slow


@pytest.fixture
def process(verilator: None, tmp_path: Path) -> Iterator[BoardProcess]:
    target = find_target("illuminator", ULX3S.name, Options(settings={"fine_delay": 1}))
    write_project(target, tmp_path, constraints=False)
    program = compile_board(tmp_path / "top.v", oscillator_hz=ULX3S.oscillator_hz)
    process = BoardProcess(program)
    start = BoardScript()
    start.wait(60 * US)  # the PLL locks, and the lines are loaded
    process.run(start)
    yield process
    process.close()


def test_wires_of_any_length(process: BoardProcess):
    board = Illuminator(process, timeout_s=0.002)

    def connect(channel: int) -> None:
        wire = BoardScript()
        wire.lines.append(f"loop {channel} {WIRE_PS[channel]}")
        process.run(wire)

    found = measure_skew(board, channels=tuple(WIRE_PS), connect=connect, dwell_s=0.001)
    assert found.step_ns == pytest.approx(STEP_NS, rel=0.015)
    for channel, wire in WIRE_PS.items():
        # each edge is known to half a step
        assert abs(found.skew_ns[channel] - (wire - WIRE_PS[0]) / 1000) <= STEP_NS
    assert found.residual_ns <= STEP_NS
    assert not board.faults().duty_limited
