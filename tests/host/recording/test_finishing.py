# SPDX-License-Identifier: Apache-2.0
"""Recordings that were cut off are finished in place, with every frame that was in a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hueflight.errors import RecordingError
from hueflight.files import PARTIAL_SUFFIX
from hueflight.model.instrument import Instrument
from hueflight.recording import RecordingWriter, finish_recording, open_recording
from hueflight.recording.layout import part_path, segment_files, segment_path
from hueflight.recording.recovery import Outcome, check_recording

Make = Callable[..., Instrument]


def cut_off(
    path: Path, instrument: Instrument, packets: list[bytes], *, segment_bytes: int
) -> None:
    """Write a recording, and leave it as a program does that is killed."""
    writer = RecordingWriter(path, instrument, segment_bytes=segment_bytes)
    for packet in packets:
        writer.write(packet)
        writer.flush()
    writer._wait_for_disk()


@pytest.mark.parametrize("segment_bytes", [1 << 30, 4000])
def test_all_frames_are_kept(
    tmp_path: Path, small: Make, frames: Callable[..., list[bytes]], segment_bytes: int
) -> None:
    packets = frames(60)
    path, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    cut_off(path, small(), packets, segment_bytes=segment_bytes)
    with RecordingWriter(whole, small()) as writer:
        writer.write(b"".join(packets))
    finished, unfinished = segment_files(path)
    assert len(unfinished) == 1
    assert finish_recording(path) == 1
    assert segment_files(path) == ([*finished, segment_path(path, len(finished))], [])
    assert check_recording(path).outcome == Outcome.WHOLE
    with open_recording(path) as found, open_recording(whole) as wanted:
        assert np.array_equal(found.histogram(), wanted.histogram())
        assert np.array_equal(found.histogram(20, 50), wanted.histogram(20, 50))
        assert found.info().complete
        assert found.info().report["frames"] == wanted.info().report["frames"] == 60
    assert finish_recording(path) == 0


def test_what_an_interrupted_try_has_left_is_removed(
    tmp_path: Path, small: Make, frames: Callable[..., list[bytes]]
) -> None:
    path = tmp_path / "cut.mcap"
    cut_off(path, small(), frames(20), segment_bytes=1 << 30)
    left = tmp_path / f".cut.mcap.1{PARTIAL_SUFFIX}"
    left.mkdir()
    (left / "cut.mcap").write_bytes(b"half")
    assert finish_recording(path) == 1
    assert list(tmp_path.iterdir()) == [path]
    with open_recording(path) as recording:
        assert list(recording.packets()) == frames(20)


def test_a_file_that_was_finished_already_is_not_needed(
    recorded: Callable[..., tuple[Path, list[bytes]]],
) -> None:
    """The program may end between the rename and the removal."""
    path, _ = recorded()
    part_path(path).write_bytes(b"rest")
    assert finish_recording(path) == 0
    assert not part_path(path).exists()


def test_a_file_without_its_first_records_is_left(tmp_path: Path) -> None:
    part = part_path(tmp_path / "empty.mcap")
    part.write_bytes(b"")
    with pytest.raises(RecordingError, match="first records are lost"):
        finish_recording(tmp_path / "empty.mcap")
    assert part.exists()
