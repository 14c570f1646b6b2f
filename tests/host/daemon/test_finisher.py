# SPDX-License-Identifier: Apache-2.0
"""The finisher: it goes on trying, says that it is alive, and keeps what is known of a run."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight.daemon import finisher as module
from hueflight.daemon.finisher import CUT_OFF, Finisher
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.errors import OutputError
from hueflight.recording import RecordingWriter, open_recording
from hueflight.recording.layout import part_path
from hueflight_protocol import encode_frame

WAIT_S = 60.0


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.01)


def cut_recording(path: Path, instrument: hf.Instrument, frames: int = 20) -> None:
    """A recording of which the program ended before it was finished."""
    writer = RecordingWriter(path, instrument)
    codes = np.zeros(instrument.image_shape, np.uint16)
    for number in range(frames):
        writer.write(encode_frame(codes, sequence=number, frame=number, timestamp=number))
    writer.flush()
    data = part_path(path).read_bytes()
    writer.close()
    path.unlink()
    part_path(path).write_bytes(data)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RecordingsFolder:
    monkeypatch.setattr(module, "BEAT_S", 0.02)
    monkeypatch.setattr(module, "RETRY_S", 0.04)
    return RecordingsFolder(tmp_path)


@pytest.fixture
def made(folder: RecordingsFolder) -> Iterator[Finisher]:
    finisher = Finisher(folder)
    yield finisher
    finisher.close()


def test_it_shows_that_it_is_alive_while_it_has_nothing_to_do(made: Finisher) -> None:
    """Without a sign of life for the time of its patience, it would count as stuck."""
    noted = made.thread._answered_s
    until(lambda: made.thread._answered_s > noted, "it shows a sign of life")
    noted = made.thread._answered_s
    until(lambda: made.thread._answered_s > noted, "and another one")
    assert made.thread._patience_s > 10 * module.BEAT_S


def test_what_fails_is_tried_again(
    made: Finisher, folder: RecordingsFolder, instrument: hf.Instrument,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """With the summary of the run, which could not be written either."""
    tried = []
    real = module.write_summary_file

    def refused(path: Path, summary: dict[str, object], /) -> None:
        tried.append(path)
        if len(tried) < 4:
            raise OutputError("the disk refuses")
        real(path, summary)

    monkeypatch.setattr(module, "write_summary_file", refused)
    path = folder.path("cut")
    cut_recording(path, instrument)
    summary = {"name": "cut", "exposed": 25, "delivered": 22, "recorded_frames": 20, "failure": "x"}
    made.finish("cut", summary)
    until(lambda: path.with_suffix(".json").exists(), "its summary is written")
    assert json.loads(path.with_suffix(".json").read_text()) == summary
    assert len(tried) == 4
    with open_recording(path) as recording:
        assert recording.frames == 20
    assert made.busy == frozenset()


def test_what_is_deleted_meanwhile_is_forgotten(
    made: Finisher, folder: RecordingsFolder, instrument: hf.Instrument,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    tried = []

    def refused(path: Path, _: object, /) -> None:
        tried.append(path)
        raise OutputError("the disk refuses")

    monkeypatch.setattr(module, "write_summary_file", refused)
    cut_recording(folder.path("cut"), instrument)
    made.finish("cut", {"name": "cut", "failure": "x"})
    until(lambda: len(tried) >= 2, "it is tried again")
    folder.delete("cut")
    until(lambda: not made._failed, "it is forgotten")
    assert list(folder.root.iterdir()) == []


def test_a_recording_without_a_summary_says_why(
    folder: RecordingsFolder, instrument: hf.Instrument
) -> None:
    cut_recording(folder.path("cut"), instrument)
    finisher = Finisher(folder)
    try:
        until(lambda: folder.path("cut").with_suffix(".json").exists(), "it is finished")
    finally:
        finisher.close()
    summary = json.loads(folder.path("cut").with_suffix(".json").read_text())
    assert (summary["recorded_frames"], summary["failure"]) == (20, CUT_OFF)
