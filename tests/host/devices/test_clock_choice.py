# SPDX-License-Identifier: Apache-2.0
"""The driver and the command choose the clock of a board in software."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from hueflight.cli.app import main
from hueflight.devices.clock_choice import ClockState
from hueflight.devices.errors import DeviceError
from hueflight.devices.illuminator import Illuminator, open_illuminator

from .conftest import PtyBoard, SoftwareIlluminator

HZ = 10_000_000


@pytest.fixture
def line() -> Iterator[PtyBoard]:
    """A board with an input for an external clock of 10 MHz."""
    line = PtyBoard(SoftwareIlluminator(external_clock=True, reference_hz=HZ))
    yield line
    line.close()


@pytest.fixture
def driver(line: PtyBoard) -> Iterator[Illuminator]:
    driver = open_illuminator(line.path, baud=3_000_000)
    yield driver
    driver.close()


def test_there_and_back(line: PtyBoard, driver: Illuminator):
    assert driver.clock() == ClockState("internal", HZ, present=False, lost=False)
    with pytest.raises(DeviceError, match=r"no clock of 10000000 Hz at the input of the board"):
        driver.choose_clock("external")
    line.board.connect_clock(True)
    driver.arm()
    assert driver.choose_clock("external") == ClockState("external", HZ, present=True, lost=False)
    assert not driver.state().armed
    assert not driver.faults().clock_failed  # that of the change is cleared
    assert driver.choose_clock("external").source == "external"
    assert driver.choose_clock("internal") == ClockState("internal", HZ, present=True, lost=False)


def test_a_loss_is_a_fault_until_it_is_cleared(line: PtyBoard, driver: Illuminator):
    line.board.connect_clock(True)
    driver.choose_clock("external")
    line.board.connect_clock(False)
    assert driver.clock() == ClockState("internal", HZ, present=False, lost=True)
    assert driver.faults().reference_lost
    driver.clear()
    assert not driver.faults().reference_lost
    line.board.connect_clock(True)
    assert driver.clock().source == "internal"  # nobody has chosen it again
    assert not driver.choose_clock("external").lost


def test_a_change_that_does_not_happen(line: PtyBoard, driver: Illuminator):
    line.board.connect_clock(True)
    line.board.dies_on_change = True
    with pytest.raises(DeviceError, match=r"still runs from its internal clock after 0\.05 s"):
        driver.choose_clock("external", timeout_s=0.05)


def test_a_build_without_an_external_clock():
    line = PtyBoard(SoftwareIlluminator())
    try:
        driver = open_illuminator(line.path, baud=3_000_000)
        assert driver.clock() == ClockState("internal", None, present=False, lost=False)
        assert driver.choose_clock("internal").source == "internal"
        with pytest.raises(DeviceError, match="was built without an external clock"):
            driver.choose_clock("external")
        driver.clear()  # the faults of this build alone
        assert not driver.faults().reference_lost
        driver.close()
    finally:
        line.close()


def test_the_command(line: PtyBoard, capsys: pytest.CaptureFixture[str]):
    def run(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["board", *words])
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    line.board.connect_clock(True)
    code, out, _ = run("clock", line.path, "--json")
    assert code == 0
    assert json.loads(out) == {
        "source": "internal",
        "reference_hz": HZ,
        "present": True,
        "lost": False,
    }
    code, out, _ = run("clock", line.path, "--source", "external")
    assert code == 0
    assert "external" in out
    line.board.connect_clock(False)
    code, _, err = run("clock", line.path, "--source", "external")
    assert code == 1
    assert "there is no clock of 10000000 Hz" in " ".join(err.split())
    code, _, err = run("selftest", line.path, "--source", "external")
    assert code == 1
    assert "belongs to `hueflight board clock`" in " ".join(err.split())
