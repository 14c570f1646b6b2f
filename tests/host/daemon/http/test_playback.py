# SPDX-License-Identifier: Apache-2.0
"""Pictures of recordings, counts and images, compared with what is made of them directly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from starlette.testclient import TestClient

import hueflight as hf
from hueflight.daemon.playable import MOST_FRAMES
from hueflight.export import describe
from hueflight.files.image_schema import SERIES_DIM
from hueflight.importers.captures import write_counts
from hueflight.live.message import Message, decode_message
from hueflight.recording.writer import RecordingWriter
from hueflight.simulator import simulate_capture, simulate_packets

FRAMES = 3000
UNKNOWN = 65535


@pytest.fixture(scope="module")
def calibration(instrument: hf.Instrument) -> hf.Calibration:
    reference = simulate_capture("reference", instrument, frames=20_000)
    return hf.calibrate(reference, instrument, distance=0.4)


@pytest.fixture
def player(
    open_daemon: Callable[..., Any],
    instrument: hf.Instrument,
    calibration: hf.Calibration,
    tmp_path: Path,
) -> Iterator[TestClient]:
    """A daemon with a recording ``film`` of 3000 frames and a calibration of its own."""
    kept = tmp_path / "data/calibrations/earlier/calibration.zarr"
    kept.parent.mkdir(parents=True)
    calibration.save(kept)
    folder = tmp_path / "data/recordings"
    folder.mkdir()
    notes = {"capture": "reference", "simulated": True, "calibration": "earlier"}
    with RecordingWriter(folder / "film.mcap", instrument, metadata=notes) as writer:
        for packet in simulate_packets("reference", instrument, frames=FRAMES, seed=3):
            writer.write(packet)
    with open_daemon(requests_per_s=1000, burst=1000) as client:
        client.post("/api/picture", json={"method": "joint"})  # also without compiled kernels
        yield client


def shown(client: TestClient, name: str, start: int, stop: int) -> Message:
    answer = client.get(f"/api/playback/{name}/picture?start={start}&stop={stop}")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/octet-stream"
    return decode_message(answer.content)


def depth_of(message: Message) -> np.ndarray:
    coded = message.planes["depth"].values
    return np.where(coded == UNKNOWN, np.nan, coded * message.header["depth_scale"])


def test_frames_of_a_recording_are_shown_as_they_are_reconstructed(
    player: TestClient, calibration: hf.Calibration, tmp_path: Path
) -> None:
    facts = player.get("/api/playback/film").json()
    assert (facts["kind"], facts["capture"], facts["length"]) == ("recording", "reference", FRAMES)
    assert (facts["calibration"], facts["simulated"]) == ("earlier", True)
    assert facts["seconds"] == pytest.approx((FRAMES - 1) / 2000, rel=1e-6)
    with hf.open_recording(tmp_path / "data/recordings/film.mcap") as recording:
        # one piece, one that goes on from it, one before, and all of it
        for start, stop in ((500, 1500), (500, 2500), (0, 400), (0, FRAMES)):
            counts = recording.histogram(start, stop)
            image = hf.reconstruct(counts, calibration, mixed=False, second_returns=False)
            message = shown(player, "film", start, stop)
            assert message.header["frames"] == stop - start
            np.testing.assert_array_equal(message.planes["photons"].values, image.photons)
            np.testing.assert_allclose(
                depth_of(message), image.depth, atol=message.header["depth_scale"]
            )
            where = f"start={start}&stop={stop}&row=2&col=3"
            pixel = player.get(f"/api/playback/film/pixel?{where}").json()
            assert pixel["counts"] == calibration.bins.in_time_order(counts[2, 3]).tolist()
            assert pixel["depth_m"] == pytest.approx(float(image.depth[2, 3]))
        began = recording.info().started
    received_s = np.datetime64(began.replace("+00:00", ""), "ms").astype(float) / 1e3
    assert message.header["received_unix_s"] == pytest.approx(
        received_s + facts["seconds"], abs=0.05
    )


def test_images_and_counts_are_listed_and_shown(
    player: TestClient, instrument: hf.Instrument, calibration: hf.Calibration, tmp_path: Path
) -> None:
    folder = tmp_path / "data/results"
    assert player.get("/api/results").json() == {"results": []}
    folder.mkdir()
    counts = [simulate_capture("reference", instrument, frames=4000, seed=s) for s in (1, 2)]
    images = [describe(hf.reconstruct(each, calibration), calibration) for each in counts]
    hf.write_image(images[0], folder / "one.zarr")
    hf.write_image(xr.concat(images, SERIES_DIM, combine_attrs="override"), folder / "two.zarr")
    write_counts(folder / "sum.npz", counts[0], instrument)
    (folder / "notes.txt").write_text("no result")
    (folder / "link.npz").symlink_to(folder / "sum.npz")
    found = {each["name"]: each["kind"] for each in player.get("/api/results").json()["results"]}
    assert found == {"one.zarr": "image", "two.zarr": "image", "sum.npz": "counts"}
    for name, length in (("one.zarr", 1), ("two.zarr", 2), ("sum.npz", 1)):
        facts = player.get(f"/api/playback/{name}").json()
        assert (facts["length"], facts["seconds"]) == (length, None), name
        assert facts["instrument"]["rows"] == 6
        for index in range(length):
            message = shown(player, name, index, index + 1)
            np.testing.assert_allclose(
                depth_of(message), images[index].depth, atol=2 * message.header["depth_scale"]
            )
            np.testing.assert_array_equal(message.planes["photons"].values, images[index].photons)
    pixel = player.get("/api/playback/two.zarr/pixel?start=1&stop=2&row=0&col=0").json()
    assert (pixel["counts"], pixel["windows"]) == ([], [])
    assert pixel["depth_m"] == pytest.approx(float(images[1].depth[0, 0]))


def test_what_is_not_there_or_broken_is_refused(player: TestClient, tmp_path: Path) -> None:
    folder = tmp_path / "data/results"
    folder.mkdir()
    (folder / "broken.npz").write_bytes(b"PK nonsense")
    (folder / "empty.zarr").mkdir()
    (tmp_path / "data/recordings/cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    cases = {
        "none": 404, "none.zarr": 404, "film.txt": 409, "..%2ffilm": 404, "broken.npz": 422,
        "empty.zarr": 422, "cut": 422, "film/picture?start=0&stop=3001": 422,
        "film/picture?start=5&stop=5": 422, "film/picture?start=0": 422,
        "film/pixel?start=0&stop=9&row=6&col=0": 404,
    }  # fmt: skip
    for path, status in cases.items():
        answer = player.get(f"/api/playback/{path}")
        assert answer.status_code == status, (path, answer.text)
        assert answer.json()["error"], path
    assert "broken.npz" in player.get("/api/playback/broken.npz").json()["error"]


def test_a_recording_that_is_deleted_is_not_played_on(player: TestClient) -> None:
    shown(player, "film", 0, 100)
    assert player.patch("/api/recordings/film", json={"name": "other"}).status_code == 200
    assert player.get("/api/playback/film/picture?start=0&stop=100").status_code == 404
    assert shown(player, "other", 0, 100).header["frames"] == 100
    assert player.delete("/api/recordings/other").status_code == 200
    assert player.get("/api/playback/other").status_code == 404


def test_no_picture_counts_without_end(player: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hueflight.daemon.playable.MOST_FRAMES", 1000)
    answer = player.get("/api/playback/film/picture?start=0&stop=1001")
    assert answer.status_code == 422
    assert "take fewer frames together" in answer.json()["error"]
    for stop in (1000, 2000, 3000):  # each goes on from the one before
        assert shown(player, "film", 0, stop).header["frames"] == stop
    assert MOST_FRAMES > 100_000
