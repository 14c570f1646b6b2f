# SPDX-License-Identifier: Apache-2.0
"""The illuminator as the illumination of captures, over a pseudo terminal and real pyserial."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("serial", reason="pyserial is not installed (extra devices)")

import hueflight as hf
from hueflight.acquisition.plan import RunPlan
from hueflight.acquisition.runner import Acquisition
from hueflight.devices import (
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceTimeoutError,
    Rig,
    ScheduledIllumination,
    rig_from_uri,
)
from hueflight.devices.built_in_rigs import open_illumination
from hueflight.model.schedules import Schedule
from hueflight_protocol.illuminator_map import Advance, TriggerSource
from hueflight_protocol.typed_registers import illuminator as registers
from support.faulty_rig import FaultyRig
from support.pty_illuminator import PtyIlluminator

WAIT_S = 60.0


@pytest.fixture
def board(fast: hf.Instrument) -> Iterator[PtyIlluminator]:
    made = PtyIlluminator(len(fast.bands))
    try:
        yield made
    finally:
        made.close()


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.01)


def test_another_schedule_is_loaded_between_runs(
    board: PtyIlluminator, fast: hf.Instrument
) -> None:
    """It lies in the bank that every kind of capture plays, and what can't be played is refused."""
    illumination = open_illumination(board.port, fast)
    assert isinstance(illumination, ScheduledIllumination)
    assert illumination.capacity.channels == len(fast.bands)
    illumination.prepare("scene", 0)
    stated = Schedule.of(fast)
    later = tuple((first + 10.0, *rest) for first, *rest in stated.delays_ns)
    illumination.load_schedule(Schedule(later, stated.period_ns).applied_to(fast))
    assert not board.state.armed  # the board locks the bank that it plays while it is armed
    for band, delays in enumerate(later):
        assert board.registers.load(registers.Pulse, 0, band, 0).delay * 1.25 == delays[0]
    assert board.registers.load(registers.BankSelect).value == 0
    once = Schedule(((0.0,),) * len(later), stated.period_ns).applied_to(fast)
    with pytest.raises(DeviceError, match=r"can't play the schedule: .*coincide"):
        illumination.load_schedule(once)
    illumination.load_schedule(fast)
    assert board.registers.load(registers.Pulse, 0, 1, 0).delay * 1.25 == stated.delays_ns[1][0]
    illumination.close()


def test_each_kind_of_capture_lights_what_it_needs(
    board: PtyIlluminator, fast: hf.Instrument
) -> None:
    illumination = open_illumination(board.port, fast)
    assert illumination.name == board.port
    assert board.registers.load(registers.Trigger).source == TriggerSource.EXTERNAL
    assert not board.state.armed
    illumination.prepare("scene", 0)
    assert board.state.armed
    assert not board.state.sequencing
    illumination.prepare("bands", 40)
    assert board.state.armed
    assert board.state.sequencing
    program = board.registers.load(registers.Sequencer)
    assert program.advance == Advance.FRAME_SYNC
    assert program.length >= len(fast.bands)
    for kind in ("dark", "flat"):
        illumination.prepare("scene", 0)
        illumination.prepare(kind, 40)
        assert not board.state.armed, kind
    illumination.prepare("scene", 0)
    fed = board.fed
    illumination.keep_alive()
    assert board.fed == fed + 1
    illumination.close()
    assert not board.state.armed


def test_a_port_that_is_held_and_one_that_is_not_there(
    board: PtyIlluminator, fast: hf.Instrument
) -> None:
    illumination = open_illumination(board.port, fast)
    with pytest.raises(DeviceBusyError, match="another program holds"):
        open_illumination(board.port, fast)
    illumination.close()
    with pytest.raises(DeviceNotFoundError, match="is the illuminator plugged in"):
        open_illumination("/dev/ttyNOT_THERE", fast)
    with pytest.raises(DeviceError, match="names no camera"):
        rig_from_uri(f"serial:{board.port}", fast)


def test_more_bands_than_the_board_has_leds(fast: hf.Instrument) -> None:
    board = PtyIlluminator(len(fast.bands) - 1)
    try:
        with pytest.raises(
            DeviceError, match="can't drive the LEDs of 'paper': 9 channels: the board has 8"
        ):
            open_illumination(board.port, fast)
        until(lambda: not board.state.armed, "it is dark")
    finally:
        board.close()


def test_a_run_survives_a_silent_line(
    board: PtyIlluminator, fast: hf.Instrument, rig: FaultyRig
) -> None:
    """Both boards in one acquisition: the line falls silent, the gap is marked, the run ends."""

    def connect() -> Rig:
        bare = rig.connect()
        try:
            return Rig(bare.camera, open_illumination(board.port, fast))
        except DeviceError:
            bare.close()
            raise

    acquisition = Acquisition(connect, fast)
    try:
        future = acquisition.run(RunPlan(seconds=3.0))
        until(lambda: board.fed >= 2, "the watchdog is fed")
        assert board.state.armed
        board.silent = True
        until(lambda: acquisition.snapshot.state == "disconnected", "the silence is noticed")
        assert board.port in acquisition.snapshot.problem
        board.silent = False
        until(lambda: acquisition.snapshot.state == "running", "it is back")
        result = future.result(WAIT_S)
    finally:
        acquisition.close()
    assert len(result.gaps) == 1
    assert result.totals.delivered > 0
    assert result.totals.delivered + result.totals.losses.undelivered == result.totals.exposed
    assert not board.state.armed


def test_silence_names_the_port(board: PtyIlluminator, fast: hf.Instrument) -> None:
    board.silent = True
    with pytest.raises(DeviceTimeoutError, match=board.port):
        open_illumination(board.port, fast)
