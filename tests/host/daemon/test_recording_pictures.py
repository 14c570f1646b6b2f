# SPDX-License-Identifier: Apache-2.0
"""Recordings of the daemon get pictures for Foxglove, and keep their packets byte for byte."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is not installed (extra dev)")

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from structlog.testing import capture_logs

import hueflight as hf
from hueflight.acquisition.sums_reduction import attachments_of, reduction_of
from hueflight.daemon.config import ConfigError, RecordingConfig
from hueflight.daemon.finisher import Finisher
from hueflight.daemon.recording_pictures import RecordingPictures
from hueflight.daemon.recordings_folder import RecordingsFolder
from hueflight.recording import RecordingWriter
from hueflight.recording.layout import segment_files
from hueflight.simulator import simulate_capture, simulate_packets
from support.sums_stream import packets_of_sums

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


@pytest.mark.slow
def test_recordings_of_sums_get_pictures_of_whole_sums(
    tmp_path: Path, instrument: hf.Instrument, draw: Callable[..., Any]
) -> None:
    calibration = hf.calibrate(draw(instrument, photons=50_000), instrument, distance=0.5)
    reduction = reduction_of(calibration, picture_frames=200)
    path = tmp_path / "sums.mcap"
    drawn = [draw(instrument, photons=60, frames=200, seed=seed) for seed in range(10)]
    with RecordingWriter(
        path, instrument, chunk_bytes=1500, segment_bytes=20_000,
        attachments=attachments_of(reduction, instrument),
    ) as writer:  # fmt: skip
        for packet in packets_of_sums(drawn, reduction):
            writer.write(packet)
    files = segment_files(path)[0]
    assert len(files) > 1
    with hf.open_recording(path) as recording:
        before = b"".join(recording.raw())
    with capture_logs() as logs:
        RecordingPictures(5.0, calibration=lambda: calibration).add(path, SUMMARY)
    assert [entry["event"] for entry in logs] == ["pictures added"]
    with hf.open_recording(path) as recording:
        assert b"".join(recording.raw()) == before
    # 480 frames are three pictures of sums, 400 frames two: behind pictures 3, 5, 7 and 9
    assert sum(topics(file).get("/depth", 0) for file in files) == 4
    photons: list[int] = []
    for file in files:
        with file.open("rb") as opened:
            for _, _, _, decoded in make_reader(
                opened, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages(topics=["/photons"]):
                photons.append(int(np.frombuffer(decoded.data, "<f4").sum()))
    expected = [
        sum(int(counts[..., 1:].sum()) for counts in drawn[end - 3 : end]) for end in (3, 5, 7, 9)
    ]
    assert photons == expected


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
