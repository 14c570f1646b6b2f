# SPDX-License-Identifier: Apache-2.0
"""Recordings of the daemon get pictures for Foxglove, and keep their packets byte for byte."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is not installed (extra dev)")

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from structlog.testing import capture_logs

import hueflight as hf
from hueflight.daemon.config import ConfigError, RecordingConfig
from hueflight.daemon.finisher import Finisher
from hueflight.daemon.recording_pictures import RecordingPictures
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.recording import RecordingWriter
from hueflight.simulator import simulate_capture, simulate_packets

FRAMES = 2000
SUMMARY = {"kind": "scene", "recorded_frames": FRAMES, "seconds": 1.0, "failure": ""}


@pytest.fixture(scope="module")
def calibration(instrument: hf.Instrument) -> hf.Calibration:
    reference = simulate_capture("reference", instrument, frames=20_000)
    return hf.calibrate(reference, instrument, distance=0.4)


@pytest.fixture
def path(tmp_path: Path, instrument: hf.Instrument) -> Path:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, instrument) as writer:
        for packet in simulate_packets("reference", instrument, frames=FRAMES, seed=3):
            writer.write(packet)
    return path


def finished(path: Path, on_finished: Callable[[Path, dict[str, Any]], None]) -> None:
    """The recording as the daemon leaves it some time after it has ended."""
    finisher = Finisher(RecordingsFolder(path.parent), on_finished=on_finished)
    finisher.finish(path.stem, dict(SUMMARY))
    deadline = time.monotonic() + 60
    while finisher.busy:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    finisher.close()


def topics(path: Path) -> dict[str, int]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found: dict[str, int] = {}
        for _, channel, message in reader.iter_messages():
            assert message.data
            found[channel.topic] = found.get(channel.topic, 0) + 1
    return found


def test_pictures_are_added_when_a_recording_has_ended(
    path: Path, calibration: hf.Calibration
) -> None:
    with hf.open_recording(path) as recording:
        before = b"".join(recording.raw())
    bytes_before = path.read_bytes()
    finished(path, RecordingPictures(5.0, calibration=lambda: calibration).add)
    with hf.open_recording(path) as recording:
        assert b"".join(recording.raw()) == before
    # five a second, each of 480 frames: at frames 480, 880, 1280 and 1680
    assert topics(path)["/depth"] == topics(path)["/points"] == 4
    half = len(bytes_before) // 2
    assert path.read_bytes()[:half] == bytes_before[:half]
    assert sorted(each.name for each in path.parent.iterdir()) == ["run.json", "run.mcap"]


@pytest.mark.parametrize(
    ("pictures_hz", "calibrated", "kind"),
    [(0.0, True, "scene"), (5.0, False, "scene"), (5.0, True, "dark")],
)
def test_nothing_is_added_unless_it_can_and_shall_be(
    path: Path, calibration: hf.Calibration, pictures_hz: float, calibrated: bool, kind: str
) -> None:
    before = path.read_bytes()
    pictures = RecordingPictures(
        pictures_hz, calibration=lambda: calibration if calibrated else None
    )
    pictures.add(path, SUMMARY | {"kind": kind})
    assert path.read_bytes() == before


def test_a_failure_leaves_the_recording_as_it_was(path: Path, calibration: hf.Calibration) -> None:
    path.write_bytes(path.read_bytes()[:-100])
    before = path.read_bytes()
    with capture_logs() as logs:
        RecordingPictures(5.0, calibration=lambda: calibration).add(path, SUMMARY)
    assert path.read_bytes() == before
    assert [entry["event"] for entry in logs] == ["pictures can't be added"]


def test_the_rate_has_limits() -> None:
    with pytest.raises(ConfigError, match="foxglove_hz"):
        RecordingConfig(foxglove_hz=-1.0)
