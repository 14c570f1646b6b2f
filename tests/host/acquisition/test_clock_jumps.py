# SPDX-License-Identifier: Apache-2.0
"""The wall clock jumps while a capture is on: durations, books and recordings don't notice."""

from __future__ import annotations

import datetime as real
import itertools
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import hueflight as hf
from hueflight.acquisition import session as acquisition_module
from hueflight.acquisition.plan import RunPlan
from hueflight.acquisition.runner import Acquisition
from hueflight.daemon import recordings_folder as files
from hueflight.recording import open_recording, writer
from support.faulty_rig import FaultyRig

WAIT_S = 60.0
# by a day, to before the epoch of most clocks, by an hour, by 30 years
JUMPS_S = (86_400.0, -1.5e9, -3_600.0, 9.5e8)


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.01)


@pytest.fixture
def jumps(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Make every look at the wall clock find that it has jumped; how often that was."""
    offsets, looks, now_ns = itertools.cycle(JUMPS_S), [0], time.time_ns

    def jumped_ns() -> int:
        looks[0] += 1
        return now_ns() + int(next(offsets) * 1e9)

    class Jumping(real.datetime):
        @classmethod
        def now(cls, tz: real.tzinfo | None = None) -> Jumping:
            return cls.fromtimestamp(jumped_ns() / 1e9, tz)

    monkeypatch.setattr(time, "time_ns", jumped_ns)
    monkeypatch.setattr(time, "time", lambda: jumped_ns() / 1e9)
    for module in (acquisition_module, writer, files):
        monkeypatch.setattr(module, "datetime", Jumping)
    return looks


def test_a_recording_with_a_gap(
    jumps: list[int], rig: FaultyRig, fast: hf.Instrument, tmp_path: Path
) -> None:
    path = tmp_path / "jumps.mcap"
    began = time.monotonic()
    acquisition = Acquisition(rig.connect, fast)
    try:
        future = acquisition.run(RunPlan(seconds=2.0, path=path))
        until(lambda: acquisition.snapshot.run_frames > 100, "frames come")
        rig.faults.plugged = False
        until(lambda: acquisition.snapshot.state == "disconnected", "the loss is noticed")
        rig.faults.plugged = True
        result = future.result(WAIT_S)
    finally:
        acquisition.close()
    took = time.monotonic() - began
    assert jumps[0] > 4
    assert not result.failure
    (gap,) = result.gaps
    assert 0 < gap.seconds < took
    assert result.totals.exposed == result.totals.delivered + result.totals.losses.undelivered
    assert result.recorded_frames == result.totals.delivered > 100
    with open_recording(path) as recording:
        assert recording.info().as_dict()["report"]["frames"] == result.totals.delivered
        assert recording.histogram()[..., 1:].sum() == result.photons


def test_names_of_recordings_stay_apart(jumps: list[int], tmp_path: Path) -> None:
    """A clock that goes back may give a name again; the recording of that name is kept."""
    folder = files.RecordingsFolder(tmp_path)
    name = files.timestamp_name()
    folder.new_path(name).write_bytes(b"earlier")
    with pytest.raises(files.RecordingNameError, match="already"):
        folder.new_path(name)
