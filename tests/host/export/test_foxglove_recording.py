# SPDX-License-Identifier: Apache-2.0
"""Pictures beside the packets of a recording, read by the official reader of MCAP and by ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is not installed (extra dev)")

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import hueflight as hf
from hueflight.cli import main
from hueflight.emulation.frame_bank import simulated_packets
from hueflight.errors import ExportError, OutputError
from hueflight.export import add_foxglove_channels
from hueflight.recording import RecordingWriter
from hueflight.recording.layout import CHANNEL, segment_files
from support.mcap_doctor import Diagnosis

COUNT, FRAMES, EVERY = 900, 400, 200


@pytest.fixture(scope="module", params=["one file", "several files"])
def recording(
    request: pytest.FixtureRequest, camera: hf.Instrument, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    sizes: dict[str, Any] = {"chunk_bytes": 20_000}
    if request.param == "several files":
        sizes["segment_bytes"] = 120_000
    with RecordingWriter(path, camera, metadata={"note": "of the tests"}, **sizes) as writer:
        for packet in simulated_packets("scene", camera.to_json(), "fig1", 0.4, COUNT, 1):
            writer.write(packet)
    assert (len(segment_files(path)[0]) > 1) == (request.param == "several files")
    return path


@pytest.fixture(scope="module")
def copy(recording: Path, calibration: hf.Calibration) -> Path:
    path = recording.with_name("shown.mcap")
    add_foxglove_channels(recording, path, calibration, every=EVERY, frames=FRAMES)
    return path


def messages(path: Path) -> dict[str, list[tuple[int, bytes, Any]]]:
    """Of all files, by topic: time, content, and what the official decoder makes of it."""
    found: dict[str, list[tuple[int, bytes, Any]]] = {}
    for file in segment_files(path)[0]:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            decode = DecoderFactory().decoder_for
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                decoder = decode(channel.message_encoding, schema)
                content = decoder(message.data) if decoder else None
                found.setdefault(channel.topic, []).append(
                    (message.log_time, message.data, content)
                )
            summary = reader.get_summary()
            assert summary is not None
            assert summary.statistics is not None
            assert summary.statistics.chunk_count == len(summary.chunk_indexes)
            assert summary.statistics.channel_count == len(summary.channels)
            assert summary.statistics.schema_count == len(summary.schemas)
    return found


def test_the_copy_is_the_same_recording(recording: Path, copy: Path) -> None:
    with hf.open_recording(recording) as first, hf.open_recording(copy) as second:
        assert b"".join(first.raw()) == b"".join(second.raw())
        assert list(first.packets()) == list(second.packets())
        assert first.metadata == second.metadata == {"note": "of the tests"}
        assert np.array_equal(first.histogram(), second.histogram())
    raw = [
        [(time, data) for time, data, _ in messages(path)[CHANNEL.topic]]
        for path in (recording, copy)
    ]
    assert raw[0] == raw[1]
    for mine, theirs in zip(segment_files(recording)[0], segment_files(copy)[0], strict=True):
        size = len(mine.read_bytes()) // 2
        assert mine.read_bytes()[:size] == theirs.read_bytes()[:size]


def test_the_doctor_finds_no_errors(recording: Path, copy: Path, tmp_path: Path) -> None:
    for path in (*segment_files(recording)[0], *segment_files(copy)[0]):
        assert Diagnosis(path).errors == []
    content = bytearray(copy.read_bytes())
    topic = content.rindex(b"/depth_std")
    content[topic : topic + 10] = b"/depth_sth"
    spoiled = tmp_path / "spoiled.mcap"
    spoiled.write_bytes(content)
    assert any("two different channels" in error for error in Diagnosis(spoiled).errors)


def test_pictures_are_those_of_their_frames(
    recording: Path, copy: Path, calibration: hf.Calibration
) -> None:
    found = messages(copy)
    ends = range(FRAMES, COUNT + 1, EVERY)
    assert len(found["/depth"]) == len(found["/points"]) == len(found["/log"]) == len(ends)
    with hf.open_recording(recording) as opened:
        for end, (_, _, message) in zip(ends, found["/depth"], strict=True):
            image = hf.reconstruct(opened.histogram(end - FRAMES, end), calibration)
            depth = np.frombuffer(message.data, "<f4").reshape(message.height, message.width)
            assert np.array_equal(depth, image.depth.values, equal_nan=True)
    times = [time for time, _, _ in found["/depth"]]
    packets = [time for time, _, _ in found[CHANNEL.topic]]
    assert times == sorted(times)
    assert packets[0] <= times[0] <= times[-1] <= packets[-1]


def test_the_command_writes_the_same(
    recording: Path, calibration: hf.Calibration, copy: Path, tmp_path: Path, capsys
) -> None:
    """With materials, whose planes are channels too; packets stay as they are."""
    calibration.save(tmp_path / "cal.zarr")
    out = tmp_path / "shown.mcap"
    words = ["export", str(recording), str(out), "-c", str(tmp_path / "cal.zarr"), "--json"]
    words += ["--every", str(EVERY), "--frames", str(FRAMES), "--index", "NGRDI"]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--library", "colorchecker", "--materials", "red,green"])
    assert ended.value.code in (0, None), capsys.readouterr().err
    mine, theirs = messages(out), messages(copy)
    assert mine.keys() - theirs.keys() == {
        "/abundance_red", "/abundance_red_std", "/abundance_green", "/abundance_green_std",
        "/unmixing_chi_square", "/index_NGRDI", "/index_NGRDI_std",
    }  # fmt: skip
    for topic in (CHANNEL.topic, "/depth"):
        assert [data for _, data, _ in mine[topic]] == [data for _, data, _ in theirs[topic]]
    for wrong, problem in (
        (["--band", "3"], "--band 3: has no effect"),
        (["--index", "NDVI", "--overwrite"], "NDVI needs a band"),
    ):
        capsys.readouterr()
        with pytest.raises(SystemExit):
            main([*words, *wrong])
        assert problem in capsys.readouterr().err
    for short, problem in (
        (words[:3], "need its calibration"),
        ([*words[:2], "a.ply"], "to .mcap"),
    ):
        with pytest.raises(SystemExit):
            main(short)
        assert problem in capsys.readouterr().err


def test_what_cannot_be_is_refused(
    recording: Path, calibration: hf.Calibration, tmp_path: Path
) -> None:
    for options, problem in (
        ({"frames": 0}, "frames = 0"),
        ({"every": -1}, "every = -1"),
        ({"frames": COUNT + 1}, f"has {COUNT} frames"),
    ):
        with pytest.raises(ExportError, match=problem):
            add_foxglove_channels(recording, tmp_path / "a.mcap", calibration, **options)
    with pytest.raises(OutputError):
        add_foxglove_channels(recording, recording, calibration)
    assert list(tmp_path.iterdir()) == []
