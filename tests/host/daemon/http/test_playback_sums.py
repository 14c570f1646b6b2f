# SPDX-License-Identifier: Apache-2.0
"""Recordings of sums are played, compared with the counts that they were made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from starlette.testclient import TestClient

import hueflight as hf
from hueflight.acquisition.sums_reduction import attachments_of, reduction_of
from hueflight.devices.reduction import Reduction
from hueflight.live.message import Message, decode_message
from hueflight.recording import RecordingWriter
from hueflight_protocol.reduction import reduce_histogram
from support.sums_stream import packets_of_sums

PICTURES, FRAMES, TICKS = 12, 500, 250_000
LOST = (7, 3)  # picture and row
UNKNOWN = 65535


@pytest.fixture(scope="module")
def calibration(instrument: hf.Instrument, draw: Callable[..., Any]) -> hf.Calibration:
    return hf.calibrate(draw(instrument, depth=0.4, photons=50_000), instrument, distance=0.4)


@pytest.fixture(scope="module")
def reduction(calibration: hf.Calibration) -> Reduction:
    return reduction_of(calibration, picture_frames=FRAMES)


@pytest.fixture(scope="module")
def drawn(instrument: hf.Instrument, draw: Callable[..., Any]) -> list[NDArray[np.uint32]]:
    return [
        draw(instrument, depth=0.5, photons=150, frames=FRAMES, seed=seed)
        for seed in range(PICTURES)
    ]


@pytest.fixture
def player(
    open_daemon: Callable[..., Any],
    instrument: hf.Instrument,
    calibration: hf.Calibration,
    reduction: Reduction,
    drawn: list[NDArray[np.uint32]],
    tmp_path: Path,
) -> Iterator[TestClient]:
    """A daemon with a recording ``film`` of twelve pictures, of which a row is lost."""
    kept = tmp_path / "data/calibrations/earlier/calibration.zarr"
    kept.parent.mkdir(parents=True)
    calibration.save(kept)
    folder = tmp_path / "data/recordings"
    folder.mkdir()
    notes = {"capture": "scene", "simulated": True, "calibration": "earlier", "clock_hz": 10**6}
    with RecordingWriter(
        folder / "film.mcap", instrument, metadata=notes, chunk_bytes=1500,
        attachments=attachments_of(reduction, instrument),
    ) as writer:  # fmt: skip
        for packet in packets_of_sums(drawn, reduction, lost=(LOST,), ticks=TICKS):
            writer.write(packet)
    with open_daemon(requests_per_s=1000, burst=1000) as client:
        yield client


def shown(client: TestClient, start: int, stop: int) -> Message:
    answer = client.get(f"/api/playback/film/picture?start={start}&stop={stop}")
    assert answer.status_code == 200, answer.text
    return decode_message(answer.content)


def counts_between(drawn: list[NDArray[np.uint32]], start: int, stop: int) -> NDArray[np.uint32]:
    """Counts of some pictures without the row that was lost."""
    kept = [counts.copy() for counts in drawn]
    kept[LOST[0]][LOST[1]] = 0
    return np.sum(kept[start:stop], axis=0, dtype=np.uint32)


@pytest.mark.slow
def test_pictures_of_sums_are_those_of_the_counts(
    player: TestClient,
    calibration: hf.Calibration,
    reduction: Reduction,
    drawn: list[NDArray[np.uint32]],
) -> None:
    facts = player.get("/api/playback/film").json()
    assert (facts["kind"], facts["length"], facts["unit"]) == ("recording", PICTURES, "pictures")
    assert (facts["calibration"], facts["seconds"]) == ("earlier", (PICTURES - 1) * TICKS / 1e6)
    tables, offsets = reduction.tables, reduction.offsets
    assert offsets is not None
    wide = replace(tables, widths=(32,) * tables.sums)
    # one piece, one that goes on from it, one before, the lost row alone, and all of it
    for start, stop in ((5, 7), (5, 11), (0, 3), (7, 8), (0, PICTURES), (0, PICTURES)):
        counts = counts_between(drawn, start, stop)
        message = shown(player, start, stop)
        frames = np.asarray(message.planes["frames"].values)
        lost = start <= LOST[0] < stop
        assert message.header["frames"] == FRAMES * (stop - start)
        assert (frames[LOST[1]] == FRAMES * (stop - start - lost)).all()
        photons = counts[..., 1:].sum(axis=-1)
        np.testing.assert_array_equal(message.planes["photons"].values, photons)
        # the sums of all the frames together, as one picture of so many frames has them
        flat = counts.reshape(-1, counts.shape[-1])
        sums = reduce_histogram(flat, wide, offsets=offsets.ravel())
        image = hf.reconstruct_sums(
            sums.reshape(*counts.shape[:2], -1),
            hf.reconstruction.SumsDesign(wide, reduction.middle_ns, reduction.reach_ns),
            calibration, offsets=offsets, frames=np.maximum(frames, 1),
        )  # fmt: skip
        coded = message.planes["depth"].values
        depth = np.where(coded == UNKNOWN, np.nan, coded * message.header["depth_scale"])
        np.testing.assert_allclose(depth, image.depth, atol=message.header["depth_scale"])
        where = f"start={start}&stop={stop}&row=2&col=3"
        pixel = player.get(f"/api/playback/film/pixel?{where}").json()
        assert (pixel["counts"], pixel["frames"]) == ([], FRAMES * (stop - start))
        assert pixel["counts_missing"]
        assert pixel["depth_m"] == pytest.approx(float(image.depth[2, 3]), rel=1e-6)
        assert len(pixel["bands"]) == 9


def test_what_is_not_there_is_refused(player: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    for part in ("start=0&stop=13", "start=5&stop=5"):
        assert player.get(f"/api/playback/film/picture?{part}").status_code == 422
    monkeypatch.setattr("hueflight.daemon.playable.MOST_PICTURES", 5)
    answer = player.get("/api/playback/film/picture?start=0&stop=6")
    assert "take fewer pictures together" in answer.json()["error"]
    for stop in (5, 10, 12):  # each goes on from the one before
        assert shown(player, 0, stop).header["frames"] == FRAMES * stop
