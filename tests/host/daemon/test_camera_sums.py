# SPDX-License-Identifier: Apache-2.0
"""Live pictures, recordings and calibrations of a camera that sends sums."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import RLock
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from starlette.testclient import TestClient

import hueflight as hf
from hueflight.acquisition.snapshot import LiveSums
from hueflight.acquisition.sums_reduction import reduction_of
from hueflight.daemon.calibration_job import CALIBRATION_NAME
from hueflight.daemon.codes_choice import Choice, CodesChoice, Wanted, choose, codes_bytes
from hueflight.daemon.sums_window import SumsWindow
from hueflight.devices.camera_controls import CameraControls
from hueflight.devices.reduction import Reduction
from hueflight.errors import HistogramError, HueflightError
from hueflight.ingest.sums_blocks import SumsBlocks
from hueflight.live.message import decode_message
from hueflight.recording import open_recording, read_sums
from hueflight_protocol import PacketHeader, ReductionRoom, Sums, encode_sums
from hueflight_protocol.links import LINKS
from hueflight_protocol.reduction import ReductionTables, reduce_histogram

WAIT_S = 60.0


def until(condition: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + WAIT_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.02)
    return found


def status(client: TestClient) -> dict[str, Any]:
    return client.get("/api/status").json()


@pytest.fixture(scope="module")
def calibration(instrument: hf.Instrument, draw: Callable[..., Any]) -> hf.Calibration:
    counts = draw(instrument, depth=0.4, photons=50_000)
    return hf.calibrate(counts, instrument, distance=0.4)


@pytest.fixture
def client(
    open_daemon: Callable[..., Any], calibration: hf.Calibration, tmp_path: Path
) -> Iterator[TestClient]:
    """A daemon of a calibrated camera that sends sums, as soon as it does."""
    folder = tmp_path / "data" / "calibrations" / "2026"
    folder.mkdir(parents=True)
    calibration.save(folder / CALIBRATION_NAME)
    with open_daemon(sends="sums", requests_per_s=1000, burst=1000) as made:
        until(lambda: status(made)["picture"]["method"] == "sums", "pictures are made of sums")
        yield made


def pixel_of_sums(client: TestClient) -> dict[str, Any] | None:
    answer = client.get("/api/pixel?row=1&col=1")
    found = answer.json() if answer.status_code == 200 else {}
    return found if found.get("counts_missing") and found["frames"] >= 400 else None


@pytest.mark.slow
def test_pictures_recordings_and_captures(client: TestClient, tmp_path: Path) -> None:
    told = status(client)
    assert told["stream"] == {
        "sent": "sums", "configured": "sums", "reason": "so configured", "link": "",
    }  # fmt: skip
    assert told["picture"]["integration_s"] is None  # photons add up without limit
    pixel = until(lambda: pixel_of_sums(client), "a pixel has the frames of 0.24 s")
    assert pixel["counts"] == []
    assert 0.2 < pixel["photons"] / pixel["frames"] < 0.4
    assert len(pixel["bands"]) == 9

    # what needs histograms says why there are none
    answer = client.post("/api/picture", json={"method": "joint"})
    assert answer.status_code == 409
    assert "the camera sends sums" in answer.json()["error"]
    for wish in ({"integration_s": 5}, {"frames": 1000}):
        answer = client.post("/api/picture", json=wish)
        assert (answer.status_code, answer.json()["method"]) == (200, "sums")

    # a recording holds sums and their tables
    client.post("/api/recordings", json={"name": "sums", "frames": 1000})
    last = until(lambda: status(client)["recording"]["last"], "the recording has ended")
    assert (last["delivered"], last["recorded_frames"], last["failure"]) == (1000, 1000, "")
    with open_recording(tmp_path / "data/recordings/sums.mcap") as recording:
        assert recording.frames == 0
        recorded = read_sums(recording)
    assert np.array_equal(np.unique(recorded.frames), [1000])
    assert recorded.losses == {}
    facts = client.get("/api/playback/sums").json()
    assert (facts["length"], facts["unit"]) == (recorded.pictures, "pictures")
    assert 0.3 < facts["seconds"] < 0.5  # from the first 240 frames to the last of 1000
    answer = client.get(f"/api/playback/sums/picture?start=0&stop={recorded.pictures}")
    assert decode_message(answer.content).header["frames"] == 1000

    # captures that need histograms have codes, and after them sums come again
    client.post("/api/recordings", json={"name": "codes", "kind": "reference", "frames": 500})
    until(lambda: status(client)["recording"]["last"]["name"] == "codes", "it has ended")
    with open_recording(tmp_path / "data/recordings/codes.mcap") as recording:
        assert recording.frames == 500
    number = status(client)["picture"]["number"]
    until(
        lambda: (
            status(client)["picture"]["number"] > number + 2
            and status(client)["picture"]["method"] == "sums"
        ),
        "pictures of sums come again",
    )
    told = status(client)
    assert told["problem"] == ""
    assert sum(told["lost"].values()) == 0


@pytest.fixture(scope="module")
def reduction(calibration: hf.Calibration) -> Reduction:
    return reduction_of(calibration, picture_frames=1000)


def picture_of(
    counts: NDArray[np.integer],
    instrument: hf.Instrument,
    reduction: Reduction,
    *,
    number: int = 0,
    lost_rows: tuple[int, ...] = (),
    run: int = 1,
) -> LiveSums:
    """A picture as the camera sends it, a row in a packet."""
    tables, offsets = reduction.tables, reduction.offsets
    assert offsets is not None
    rows, cols, codes = counts.shape
    flat = reduce_histogram(counts.reshape(-1, codes), tables, offsets=offsets.ravel())
    values = flat.reshape(rows, cols, -1).astype(np.uint32)
    gathered, blocks = SumsBlocks(), []
    for row in set(range(rows)) - set(lost_rows):
        part = Sums(
            header=PacketHeader(sequence=row), values=values[row], widths=tables.widths,
            picture=number, first_pixel=row * cols, rows=rows, cols=cols, frames=1000,
            tables=tables.hash,
        )  # fmt: skip
        blocks += gathered.feed(encode_sums(part))
    (block,) = [*blocks, *gathered.finish()]
    return LiveSums(block, 0.0, "scene", run, instrument, reduction, 1)


@pytest.mark.slow
@pytest.mark.parametrize("length", [1, 3, 25])
def test_a_window_holds_the_newest_pictures(
    instrument: hf.Instrument,
    calibration: hf.Calibration,
    reduction: Reduction,
    draw: Callable[..., Any],
    length: int,
) -> None:
    window = SumsWindow(length)
    drawn = [draw(instrument, depth=0.5, photons=150, frames=1000, seed=seed) for seed in range(30)]
    for number, counts in enumerate(drawn):
        lost = (2,) if number == 29 else ()
        window.add_all([picture_of(counts, instrument, reduction, number=number, lost_rows=lost)])
    held = int(window.frames_by_pixel.max()) // 1000
    assert length <= held <= 1.2 * length
    photons = np.sum([counts[..., 1:].sum(axis=-1) for counts in drawn[30 - held :]], axis=0)
    photons[2] -= drawn[29][2, :, 1:].sum(axis=-1)
    assert np.array_equal(window.photons, photons)
    assert (window.frames_by_pixel[2] == 1000 * (held - 1)).all()
    image = window.reconstruct(calibration)
    errors = (image["depth"] - 0.5) / image["depth_std"]
    assert float(abs(errors).median()) < 1.5
    window.add_all([picture_of(drawn[0], instrument, reduction, run=2)])
    assert window.frames_by_pixel.max() == 1000


@pytest.mark.slow
def test_a_saturated_picture_saturates_the_sum_of_several(
    instrument: hf.Instrument,
    calibration: hf.Calibration,
    reduction: Reduction,
    draw: Callable[..., Any],
) -> None:
    counts = draw(instrument, depth=0.5, photons=150, frames=1000)
    bright = counts.copy()
    bright[1, 1, 1:] += 1000
    window = SumsWindow(3)
    window.add_all([picture_of(each, instrument, reduction) for each in (bright, counts)])
    quality = window.reconstruct(calibration)["quality"].values
    saturated = (quality & int(hf.Quality.SATURATED)) != 0
    assert np.argwhere(saturated).tolist() == [[1, 1]]


@pytest.mark.slow
def test_sums_of_other_tables_are_refused(
    instrument: hf.Instrument, reduction: Reduction, draw: Callable[..., Any]
) -> None:
    picture = picture_of(draw(instrument, photons=150, frames=1000), instrument, reduction)
    other = replace(reduction, tables=replace(reduction.tables, first=0))
    with pytest.raises(HistogramError, match="sums of the tables"):
        SumsWindow(1).add_all([replace(picture, reduction=other)])


@pytest.mark.slow
def test_tables_fit_the_room_of_the_camera(calibration: hf.Calibration) -> None:
    found = reduction_of(calibration, picture_frames=600, room=ReductionRoom(12, 3, 16))
    assert (found.tables.sums, found.tables.entry_bits) == (12, 3)
    with pytest.raises(HueflightError, match="the camera has room for 7"):
        reduction_of(calibration, picture_frames=600, room=ReductionRoom(15, 8, 7))


def test_sums_of_little_room_are_sent_more_often_and_added_up(
    instrument: hf.Instrument, calibration: hf.Calibration, draw: Callable[..., Any]
) -> None:
    """At the load that 18,600 frames per second of the paper's sensor would have."""
    room = ReductionRoom(12, 3, 10, 8, narrow=8)
    rate_hz = 18_600 * 192 * 128 / np.prod(instrument.image_shape)
    found = reduction_of(calibration, picture_frames=620, room=room, rate_hz=rate_hz)
    assert found.frames == 432
    assert all(w <= most for w, most in zip(found.tables.widths, room.widths, strict=True))
    assert found.tables.widths[0] == 9  # counts 432 photons
    window = SumsWindow(1, frames=620)
    counts = draw(instrument, photons=150, frames=432)
    window.add_all([picture_of(counts, instrument, found) for _ in range(4)])
    assert (window.frames_by_pixel == 2 * 1000).all()  # as `picture_of` states
    assert window.reconstruct(calibration)["depth"].notnull().all()


def test_codes_are_sent_where_the_link_carries_them(paper: hf.Instrument) -> None:
    sensor, usb = paper.sensor, LINKS["USB 2"]

    def auto(load: float | None, **about: Any) -> str:
        options: dict[str, Any] = {"obstacle": "", "link": "USB 2", "present": "codes"} | about
        return choose("auto", codes_bytes_per_s=load, **options).sent

    assert auto(480 * codes_bytes(sensor, 0.3)) == "codes"
    assert auto(18_600 * codes_bytes(sensor, 0.05)) == "sums"
    assert auto(18_600 * codes_bytes(sensor, 0.3), link="FT601") == "codes"
    assert auto(18_600 * codes_bytes(sensor, 0.9), link="FT601") == "sums"
    # back to codes only if there is room to spare, so that it does not change all the time
    assert [auto(0.95 * usb, present=sent) for sent in ("codes", "sums")] == ["codes", "sums"]
    assert auto(0.85 * usb, present="sums") == "codes"
    assert auto(None, present="sums") == "sums"
    assert auto(2 * usb, link="") == "codes"
    assert auto(2 * usb, obstacle="no calibration") == "codes"
    about: dict[str, Any] = {"link": "USB 2", "codes_bytes_per_s": 2 * usb, "present": "codes"}
    assert choose("codes", obstacle="", **about) == Choice("codes", "so configured")
    assert choose("sums", obstacle="no room", **about) == Choice("codes", "no sums: no room")


def test_runs_that_need_histograms_take_what_the_link_carries(paper: hf.Instrument) -> None:
    reduction = Reduction(ReductionTables(np.ones((1, 512), int), (16,), 0, 511), frames=620)
    fast = CameraControls(rate_hz=18_600.0, reduction=reduction, codes_rate_hz=1900.0)
    assert fast.with_histograms(paper) == CameraControls(rate_hz=1900.0, codes_rate_hz=1900.0)
    slow = replace(fast, rate_hz=480.0)
    assert slow.with_histograms(paper).rate_hz == 480.0
    both = replace(fast, reduction=replace(reduction, with_codes=True))
    assert both.with_histograms(paper) == replace(both, rate_hz=1900.0)
    assert replace(both, codes_rate_hz=None).with_histograms(paper).rate_hz == 18_600.0


@pytest.mark.parametrize("wanted", ["auto", "codes"])
@pytest.mark.parametrize(
    ("link", "rate_hz", "limited"),
    [
        ("USB 2", 18_600.0, True),
        ("USB 2", 480.0, False),
        ("FT601", 18_600.0, True),
        ("", 18_600.0, False),
    ],
)
def test_captures_are_slowed_down_before_any_light_was_measured(
    paper: hf.Instrument, wanted: Wanted, link: str, rate_hz: float, limited: bool
) -> None:
    """The target of a capture may be brighter than what was seen before it, if anything was."""
    acquisition: Any = SimpleNamespace(
        instrument=paper,
        controls=CameraControls(),
        snapshot=SimpleNamespace(
            connections=1, kind="live", link=link, rate_hz=0.0, reduction_room=None, photons=0,
            totals=SimpleNamespace(delivered=0),
        ),
    )  # fmt: skip
    acquisition.set_controls = lambda controls, settings: setattr(acquisition, "controls", controls)
    settings: Any = SimpleNamespace(rate_hz=rate_hz, block_frames=620)
    choice = CodesChoice(
        acquisition, wanted, calibration=lambda: None, settings=lambda: settings, lock=RLock()
    )
    choice.close()
    choice.look()
    found = acquisition.controls.codes_rate_hz
    if not limited:
        assert found is None
        return
    load = found * codes_bytes(paper.sensor, 1.0) / LINKS[link]
    assert 0.8 < load < 0.95  # a link that is used to the last byte loses frames
