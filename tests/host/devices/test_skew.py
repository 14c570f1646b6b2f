# SPDX-License-Identifier: Apache-2.0
"""Step and skew of fine delay lines, measured on loops whose length is known."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from hueflight.cli.app import main
from hueflight.devices import DeviceError
from hueflight.devices.fine_delays import FineDelays
from hueflight.devices.illuminator import Illuminator, open_illuminator
from hueflight.devices.pulse_schedule import ScheduleError
from hueflight.devices.skew import SkewError, fit_line, measure_skew, staircase, turn_ticks
from hueflight_protocol import Register
from hueflight_protocol.illuminator_map import TriggerSource

from .conftest import PtyBoard, SoftwareIlluminator

TICK_NS = 1.25
TURNS = 400


class LoopedIlluminator(SoftwareIlluminator):
    """The output of one channel leads to the trigger.

    Attributes
    ----------
    wired : channel whose output is led to the trigger, or None.
    loop_ns : length of the loop of each channel at setting 0.
    line_ns : delay of a line at each setting.
    jitter_ns : standard deviation of each turn.
    uneven_ns : by how much outputs at odd phases of the clock are late, as by its duty cycle.
    """

    def __init__(self, loop_ns: Sequence[float], line_ns: np.ndarray, jitter_ns: float) -> None:
        super().__init__(fine_steps=128)
        self.wired: int | None = None
        self.loop_ns = loop_ns
        self.line_ns = line_ns
        self.jitter_ns = jitter_ns
        self.uneven_ns = 0.0
        self.random = np.random.default_rng(17)
        self.begun = False

    def _wrote(self, register: Register, indices: tuple[int, ...], word: int) -> None:
        super()._wrote(register, indices, word)
        match register.name:
            case "trigger" | "arm":
                trigger = self.registers.registers["trigger"].decode(self.registers.get("trigger"))
                # trains that run while the board is armed are what starts the loop
                running = trigger["source"] == TriggerSource.INTERNAL
                self.begun = bool(self.state("armed")) and (running or self.begun)
            case "clear" if word & 2:
                self._turn()

    def _turn(self) -> None:
        counts = np.zeros(4, int)
        if self.begun and self.wired is not None and self.state("armed"):
            setting = self.registers.get("fine_delay", self.wired)
            loop = self.loop_ns[self.wired] + self.line_ns[setting]
            phase = 0
            for turn_ns in loop + self.random.normal(0, self.jitter_ns, TURNS):
                late_ns = turn_ns + self.uneven_ns * (phase % 2)
                phase = (phase + math.ceil(late_ns / TICK_NS)) % 4
                counts[phase] += 1
        for phase in range(4):
            self.registers.set("phase_count", phase, value=int(counts[phase]))
        self.registers.set("phase", valid=int(counts.any()))


def driver_of(board: SoftwareIlluminator) -> Iterator[Illuminator]:
    line = PtyBoard(board)
    try:
        driver = open_illuminator(line.path, baud=3_000_000)
        yield driver
        driver.close()
    finally:
        line.close()


def looped(
    *, step_ns: float = 0.025, bend_ns: float = 0.0, jitter_ns: float = 0.0, seed: int = 1
) -> LoopedIlluminator:
    """Nine loops of any length within a clock or so, and lines of a step, bent in the middle."""
    random = np.random.default_rng(seed)
    loop_ns = (712.3 + random.uniform(-2.4, 2.4, 9)).tolist()
    setting = np.arange(128)
    return LoopedIlluminator(
        loop_ns, setting * step_ns + bend_ns * np.sin(math.pi * setting / 127), jitter_ns
    )


@pytest.mark.parametrize(
    ("step_ns", "jitter_ns", "seed"),
    [(0.025, 0.0, 1), (0.0231, 0.0, 2), (0.0291, 0.0, 3), (0.025, 0.02, 4)],
)
def test_step_and_skew_are_found(step_ns: float, jitter_ns: float, seed: int):
    board = looped(step_ns=step_ns, jitter_ns=jitter_ns, seed=seed)
    for driver in driver_of(board):
        found = measure_skew(driver, connect=lambda channel: setattr(board, "wired", channel))
        assert not driver.state().armed
        # an edge is known to half a step, and the step from edges about fifty settings apart
        assert found.step_ns == pytest.approx(step_ns, rel=0.01 + jitter_ns)
        true = np.array(board.loop_ns) - board.loop_ns[0]
        off = (np.array(found.skew_ns) - true + 2.5) % 5 - 2.5
        assert np.abs(off).max() < 1.5 * step_ns + jitter_ns
        assert found.residual_ns < step_ns + jitter_ns
        lines = driver.fine_delays()
        assert lines == FineDelays(128, 0.025, (0,) * 9, (0.0,) * 9)


def test_a_bent_line_is_told():
    board = looped(bend_ns=0.1, seed=5)
    for driver in driver_of(board):
        found = measure_skew(driver, connect=lambda channel: setattr(board, "wired", channel))
        assert 0.03 < found.residual_ns < 0.1  # half a step is 0.0125 ns


def test_uneven_phases_of_the_clock_cancel():
    """They shift all channels alike; the distance from a straight line tells of them."""
    board = looped(jitter_ns=0.005, seed=6)
    board.uneven_ns = 0.06
    for driver in driver_of(board):
        found = measure_skew(driver, connect=lambda channel: setattr(board, "wired", channel))
        off = np.array(found.skew_ns) - np.array(board.loop_ns) + board.loop_ns[0]
        assert np.abs((off + 2.5) % 5 - 2.5).max() < 0.0375  # a step and a half
        assert 0.025 < found.residual_ns < 0.1


def test_only_some_channels():
    board = looped()
    asked: list[int] = []

    def connect(channel: int) -> None:
        asked.append(channel)
        board.wired = channel
        assert not board.state("armed")  # who moves the wire is not in the light

    for driver in driver_of(board):
        found = measure_skew(driver, channels=(3, 5), connect=connect)
        assert asked == [3, 5]
        assert found.skew_ns[3] == 0.0
        assert [math.isnan(skew) for skew in found.skew_ns] == [c not in (3, 5) for c in range(9)]


def test_settings_and_filter_stay_as_they_were():
    board = looped()
    board.wired = 0
    for driver in driver_of(board):
        board.registers.set("fine_delay", 4, value=77)
        again = Illuminator(driver.board.transport)
        again.set_trigger(TriggerSource.EXTERNAL, filter_ns=5)
        measure_skew(again, channels=(0,))
        assert board.registers.get("fine_delay", 4) == 77
        assert board.registers.get("fine_delay", 0) == 0
        assert board.registers.get("trigger_filter") == 4


def test_a_loop_that_is_open():
    for driver in driver_of(looped()):
        with pytest.raises(SkewError, match=r"channel 2: 0 triggers in 0\.005 s: lead its output"):
            measure_skew(driver, channels=(2,))
        assert not driver.state().armed


def test_boards_that_do_not_have_what_it_takes():
    for driver in driver_of(SoftwareIlluminator()):
        with pytest.raises(ScheduleError, match="without fine delay lines"):
            measure_skew(driver)
    for driver in driver_of(SoftwareIlluminator(fine_steps=128, lanes=2)):
        with pytest.raises(SkewError, match="2 ticks in a clock"):
            measure_skew(driver)
    for driver in driver_of(looped()):
        with pytest.raises(SkewError, match="channel 9: the board has 0 to 8"):
            measure_skew(driver, channels=(9,))
        driver.arm()
        with pytest.raises(DeviceError, match="is armed: another program may use it"):
            measure_skew(driver)


@pytest.mark.parametrize("length", range(100, 108))
def test_counts_tell_the_length_of_a_turn(length: int):
    """From any start, over any number of turns."""
    for start, turns in ((0, 100), (3, 101), (2, 102), (1, 103)):
        places = (start + length * np.arange(turns)) % 4
        assert length % 4 in turn_ticks(np.bincount(places, minlength=4).tolist())


def test_turns_that_differ_are_nothing():
    assert turn_ticks((0, 0, 0, 0)) == ()
    assert turn_ticks((90, 10, 0, 0)) == ()
    assert turn_ticks((50, 0, 30, 0)) == ()
    assert turn_ticks((25, 25, 25, 28)) == ()


def test_a_loop_that_gets_shorter_is_refused():
    with pytest.raises(SkewError, match=r"channel 4: .* edges at 15, 40; look at the trigger"):
        staircase({0: (0,), 20: (2,), 10: (0,), 30: (2,), 50: (1, 3)}, 4)


def test_a_line_without_a_tick_of_range():
    with pytest.raises(SkewError, match="less than a tick"):
        fit_line({0: (1, (40.0,))}, 9, TICK_NS)


def test_the_command(capsys: pytest.CaptureFixture[str]):
    board = looped()
    board.wired = 2  # as a photodiode that sees this LED alone
    line = PtyBoard(board)
    try:
        words = ["board", "skew", line.path, "--led", "2", "--yes"]
        with pytest.raises(SystemExit) as ended:
            main([*words, "--json"])
        out = capsys.readouterr().out
        found = json.loads(out[out.index("{") :])
        assert not ended.value.code
        assert found["step_ns"] == pytest.approx(0.025, rel=0.02)
        assert found["skew_ns"] == [None, None, 0.0, *[None] * 6]
        with pytest.raises(SystemExit):
            main(words)
        assert "LED 2, skew ns" in capsys.readouterr().out
        with pytest.raises(SystemExit) as ended:
            main(["board", "clock", line.path, "--led", "2"])
        assert ended.value.code == 1
        assert "--led 2: belongs to `hueflight board skew`" in capsys.readouterr().err
    finally:
        line.close()
