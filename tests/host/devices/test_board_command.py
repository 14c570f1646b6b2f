# SPDX-License-Identifier: Apache-2.0
"""``hueflight board`` on a board in software behind a pseudo terminal."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from hueflight.cli.app import main
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.transports.replay import ReplayTransport

from .conftest import PtyBoard


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of ``hueflight board selftest``."""
    with pytest.raises(SystemExit) as ended:
        main(["board", "selftest", *words])
    printed = capsys.readouterr()
    return int(ended.value.code or 0), printed.out, printed.err


def test_a_good_line_passes_and_its_transactions_replay(
    line: PtyBoard, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    record = tmp_path / "board.jsonl"
    words = ("--no-leds", "--words", "20", "--json", "--record", str(record))
    code, out, err = run(capsys, line.path, *words)
    assert (code, err) == (0, "")
    found = json.loads(out[out.index("{") :])  # threads of earlier tests may still log
    assert found["passed"]
    assert [test["name"] for test in found["tests"]] == ["clock", "line"]
    assert found["tests"][1]["measured"] == "0 of 20 words wrong, 0 messages damaged, 0 sent again"
    assert Illuminator(ReplayTransport(record)).identity.serial == "000000000000BEEF"


@pytest.mark.parametrize(
    "spoil",
    [lambda frame: frame[:3] + frame[4:], lambda frame: frame[:-2] + bytes([frame[-2] ^ 1, 0])],
    ids=["a byte lost", "a bit flipped"],
)
def test_a_line_that_damages_answers_fails(
    line: PtyBoard, capsys: pytest.CaptureFixture[str], spoil: Callable[[bytes], bytes]
):
    sent = iter(range(1000))
    line.spoil = lambda frame: spoil(frame) if next(sent) == 60 else frame
    code, _, err = run(capsys, line.path, "--no-leds", "--words", "40")
    assert code == 1
    assert "line: FAILED: 0 of 40 words wrong, 0 messages damaged, 1 sent again" in err


def test_leds_that_are_not_triggered_fail(line: PtyBoard, capsys: pytest.CaptureFixture[str]):
    """The board in software has no internal trigger: it is a board that does not fire."""
    code, _, err = run(capsys, line.path, "--words", "1", "--dwell", "0")
    assert code == 1
    assert "LED 8: FAILED: 0 trains" in err.replace("\n", " ")
    assert "line: passed" in err
    assert not line.board.state("armed")


@pytest.mark.parametrize("words", [("--words", "0"), ("--dwell=-1",)])
def test_impossible_numbers_are_refused(
    line: PtyBoard, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
):
    code, _, err = run(capsys, line.path, *words)
    assert code == 1
    assert "must be at least 1 word" in err
