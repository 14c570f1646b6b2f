# SPDX-License-Identifier: Apache-2.0
"""No name from a client leads out of the data folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import hueflight as hf
from hueflight.daemon.recordings_folder import RecordingNameError, RecordingsFolder
from hueflight.recording import RecordingWriter
from hueflight.recording.layout import part_path, segment_path
from hueflight_protocol import encode_frame


@given(st.text(max_size=80))
@example("../../etc/passwd")
@example("a/b")
@example("a\\b")
@example("a\0b")
@example(".hidden")
@example("a.mcap/../../x")
@example("a\n")
def test_a_name_stays_in_the_folder_or_is_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    root = tmp_path_factory.getbasetemp() / "names"
    folder = RecordingsFolder(root)
    try:
        path = folder.path(name)
    except RecordingNameError:
        return
    assert path.parent == root.resolve()
    assert path.name == f"{name}.mcap"


def test_links_that_lead_out_are_refused(tmp_path: Path) -> None:
    folder = RecordingsFolder(tmp_path / "data")
    (tmp_path / "data" / "link.mcap").symlink_to(tmp_path / "elsewhere.mcap")
    with pytest.raises(RecordingNameError, match="outside the data folder"):
        folder.path("link")


def test_names_are_used_once(tmp_path: Path) -> None:
    folder = RecordingsFolder(tmp_path)
    (tmp_path / "a.mcap").write_bytes(b"")
    part_path(tmp_path / "b.mcap").write_bytes(b"")
    segment_path(tmp_path / "c.mcap", 3).write_bytes(b"")
    part_path(segment_path(tmp_path / "d.mcap", 3)).write_bytes(b"")
    assert folder.new_path("e").name == "e.mcap"
    for taken in ("a", "b", "c", "d"):
        with pytest.raises(RecordingNameError, match="exists already"):
            folder.new_path(taken)


def test_a_listed_recording_has_the_size_of_all_its_segments(
    tmp_path: Path, instrument: hf.Instrument
) -> None:
    """Segments are files that the writer made, so that their names are the real ones."""
    codes = np.random.default_rng(0).integers(0, 512, (30, *instrument.image_shape))
    packets = [
        encode_frame(frame, sequence=i, frame=i, timestamp=i) for i, frame in enumerate(codes)
    ]
    folder = RecordingsFolder(tmp_path / "data")
    for name in ("run", "run2"):
        with RecordingWriter(
            folder.path(name), instrument, segment_bytes=1000, chunk_bytes=300
        ) as writer:
            for packet in packets:
                writer.write(packet)
    files = list(folder.root.glob("run.*"))
    assert len(files) > 3
    listed = {entry["name"]: entry for entry in folder.listing()}
    assert set(listed) == {"run", "run2"}
    assert listed["run"]["segments"] == len(files)
    assert listed["run"]["bytes"] == sum(file.stat().st_size for file in files)
