# SPDX-License-Identifier: Apache-2.0
"""The client against a real daemon on loopback."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import xarray as xr

import hueflight as hf
from hueflight.client import (
    Client,
    ClientError,
    ConnectionLostError,
    NoPictureError,
    RefusedError,
    TokenError,
)
from support.daemon_process import Daemon, until

StartDaemon = Callable[..., Daemon]
WAIT_S = 60.0
TOKEN = "a-token-of-the-tests"


@pytest.fixture
def camera(daemon: Daemon) -> Any:
    with hf.connect(daemon.url) as client:
        client.start()
        yield client


def numbers(pictures: list[xr.Dataset]) -> list[int]:
    return [picture.attrs["number"] for picture in pictures]


def test_ten_lines_to_the_first_picture(daemon: Daemon) -> None:
    with hf.connect(urlsplit(daemon.url).netloc) as camera:
        camera.start()
        picture = camera.picture(timeout_s=WAIT_S)
    assert picture.photons.shape == camera.instrument.image_shape == (24, 16)
    assert picture.attrs["kind"] == "scene"


def test_pictures_are_new_ones_in_their_order(camera: Client) -> None:
    found = numbers(list(islice(camera.pictures(timeout_s=WAIT_S), 10)))
    assert found == sorted(set(found))


def test_all_pictures_come_without_a_gap(camera: Client) -> None:
    pictures = list(islice(camera.pictures("all", timeout_s=WAIT_S), 12))
    assert np.diff(numbers(pictures)).tolist() == [1] * 11
    assert {picture.attrs["missed_pictures"] for picture in pictures} == {0}


def test_a_slow_client_gets_the_newest_and_knows_what_it_missed(
    camera: Client, daemon: Daemon
) -> None:
    """While the client sleeps, pictures are made as before, and no frame is lost."""
    pictures = camera.pictures(timeout_s=WAIT_S)
    first = next(pictures)
    until(lambda: daemon.status()["picture"]["number"] > first.attrs["number"] + 40, "pictures")
    before = daemon.status()
    second = next(pictures)
    # a picture counts as made a moment before it can be sent
    assert second.attrs["number"] >= before["picture"]["number"] - 1
    assert second.attrs["missed_pictures"] == second.attrs["number"] - first.attrs["number"] - 1
    assert sum(daemon.status()["lost"].values()) == 0


def test_of_all_pictures_a_slow_client_gets_the_latest_32(camera: Client, daemon: Daemon) -> None:
    pictures = camera.pictures("all", timeout_s=WAIT_S)
    first = next(pictures).attrs["number"]
    until(lambda: daemon.status()["picture"]["number"] > first + 100, "more than are kept")
    taken = [next(pictures) for _ in range(40)]
    missed = [picture.attrs["missed_pictures"] for picture in taken]
    assert sum(count > 0 for count in missed) == 1  # one gap, not many
    assert sum(missed) >= 100 - 16 - 32 - 1
    assert sum(daemon.status()["lost"].values()) == 0


def test_an_exposure_has_its_frames_and_no_older_photons(camera: Client) -> None:
    camera.picture(timeout_s=WAIT_S)
    for wanted, given in ((1, 16), (100, 112), (200, 288), (0, 16)):  # 0: photons add up again
        before = camera.picture(timeout_s=WAIT_S)
        picture = camera.expose(wanted, timeout_s=WAIT_S)
        # of one summed frame after another, the pictures do not overlap
        elapsed_s = picture.attrs["device_s"] - before.attrs["device_s"]
        assert picture.attrs["frames"] >= given
        assert elapsed_s >= picture.attrs["frames"] / 480 - 1e-6
    with pytest.raises(RefusedError, match="frames"):
        camera.expose(-1)


def test_no_picture_in_time(camera: Client) -> None:
    camera.picture(timeout_s=WAIT_S)
    camera.stop()
    until(lambda: camera.status()["state"] == "idle", "the run has ended")
    pictures = islice(camera.pictures(timeout_s=0.3), 100)
    with pytest.raises(NoPictureError, match=r"within 0.3 s") as caught:
        list(pictures)  # those that were made before the stop still come
    assert isinstance(caught.value, TimeoutError)
    camera.start()
    assert camera.picture(timeout_s=WAIT_S).attrs["received_unix_s"] > time.time() - WAIT_S


def test_recordings_are_made_listed_and_downloaded(camera: Client, tmp_path: Path) -> None:
    name = camera.record("run-1", frames=300, note="of the tests")
    summary = camera.wait_for_recording(name, timeout_s=WAIT_S)
    assert summary["recorded_frames"] == 300
    [listed] = [each for each in camera.recordings() if each.name == name]
    path = camera.download(name, tmp_path)
    assert path.stat().st_size == listed.bytes
    with hf.open_recording(path) as recording:
        assert recording.info().as_dict()["report"]["frames"] == 300
        assert recording.histogram().shape == camera.instrument.histogram_shape
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(FileExistsError, match=r"run-1\.mcap"):
        camera.download(name, tmp_path)


def until_pictures_are_of(instrument: hf.Instrument, client: Client) -> None:
    """Wait until pictures have another schedule: the daemon forgets those before it."""
    fingerprint = instrument.fingerprint()
    deadline = time.monotonic() + 120
    while client.picture(timeout_s=WAIT_S).attrs.get("instrument_fingerprint") != fingerprint:
        assert time.monotonic() < deadline, "no picture with the schedule's calibration came"


def test_the_schedule_is_changed_and_the_instrument_follows(daemon: Daemon) -> None:
    """Of the client that changes it, and of pictures that another client receives."""
    with hf.connect(daemon.url) as changing, hf.connect(daemon.url) as looking:
        stated = looking.instrument
        assert looking.controls()["schedule"] is None
        delays = [band.delays_ns[0] for band in stated.bands]
        set_to = changing.set_controls(schedule={"delays_ns": [*delays[:-1], delays[-1] + 5]})
        assert changing.instrument.bands[-1].delays_ns == (delays[-1] + 5,)
        assert set_to["schedule"]["delays_ns"][-1] == [delays[-1] + 5]
        until_pictures_are_of(changing.instrument, looking)
        described = looking.picture(timeout_s=WAIT_S).attrs["instrument_description"]
        assert hf.Instrument.from_json(described) == changing.instrument
        assert changing.set_controls(schedule=None)["schedule"] is None
        assert changing.instrument == stated
        until_pictures_are_of(stated, looking)
        with pytest.raises(RefusedError, match="the schedule is for 2 bands"):
            looking.set_controls(schedule={"delays_ns": [0, 30]})


def test_refusals_give_the_reason_of_the_daemon(camera: Client, tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="no recording is in progress") as caught:
        camera.stop_recording()
    assert caught.value.status == 409
    with pytest.raises(RefusedError, match=r"frames"):
        camera.record(frames=-1)
    camera.picture(timeout_s=WAIT_S)
    with pytest.raises(RefusedError, match=r"pixel \(1000, 0\) is outside"):
        camera.pixel(1000, 0)
    with pytest.raises(ClientError, match=r"no finished recording called 'other'"):
        camera.download("other", tmp_path)
    with pytest.raises(ClientError, match=r"'newes': choose one of newest, all"):
        next(camera.pictures("newes"))  # type: ignore[arg-type] # a user's typing error


def test_asyncio_does_the_same(daemon: Daemon, tmp_path: Path) -> None:
    async def program() -> tuple[list[int], str, Path, xr.Dataset]:
        async with await hf.connect_async(daemon.url) as camera:
            await camera.start()
            found = []
            async for picture in camera.pictures("all", timeout_s=WAIT_S):
                found.append(picture.attrs["number"])
                if len(found) == 5:
                    break
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(_stalled(camera), 0.5)
            picture = await camera.picture(timeout_s=WAIT_S)
            name = await camera.record("run-2", frames=100)
            await camera.wait_for_recording(name, timeout_s=WAIT_S)
            path = await camera.download(name, tmp_path)
            return found, (await camera.status())["state"], path, picture

    found, state, path, picture = asyncio.run(program())
    assert found == list(range(found[0], found[0] + 5))
    assert state in ("running", "starting", "stopping", "idle")
    assert path.exists()
    assert picture.photons.sum() > 0


async def _stalled(camera: Any) -> None:
    """Wait for a picture of a stopped camera, until cancelled."""
    await camera.stop()
    while True:
        await camera.picture(timeout_s=None)


def test_the_token(start: StartDaemon, tmp_path: Path) -> None:
    secret = tmp_path / "token"
    secret.write_text(TOKEN)
    secret.chmod(0o600)
    daemon = start(tmp_path, token_file=str(secret), max_viewers=1)
    with pytest.raises(TokenError, match="none was sent"):
        hf.connect(daemon.url)
    with pytest.raises(PermissionError, match="is another one"):
        hf.connect(daemon.url, token=TOKEN + "x")
    with hf.connect(f"{daemon.url}/#token={TOKEN}") as camera:
        camera.start()
        pictures = camera.pictures(timeout_s=WAIT_S)
        assert next(pictures).photons.sum() > 0
        with (
            hf.connect(daemon.url, token=TOKEN, reconnect_s=0.5) as other,
            pytest.raises(ConnectionLostError, match=r"server\.max_viewers"),
        ):
            other.picture()


def test_the_connection_comes_back_and_is_given_up(start: StartDaemon, tmp_path: Path) -> None:
    daemon = start(tmp_path)
    port = int(urlsplit(daemon.url).port or 0)
    with hf.connect(daemon.url, reconnect_s=WAIT_S) as camera:
        camera.start()
        pictures = camera.pictures(timeout_s=WAIT_S)
        next(pictures)
        daemon.end()
        again = start(tmp_path, port=port)
        again.post("/api/start")
        assert next(pictures).photons.sum() > 0
    with hf.connect(daemon.url, reconnect_s=0.5) as camera:
        camera.picture(timeout_s=WAIT_S)
        again.end()
        with pytest.raises(ConnectionLostError, match=r"within 0.5 s"):
            camera.picture(timeout_s=WAIT_S)


def test_calibrated_pictures_have_the_values_of_the_reconstruction(
    start: StartDaemon, tmp_path: Path
) -> None:
    """A picture is an image as `reconstruct` gives it, exact, and can be exported."""
    daemon = start(tmp_path)
    with hf.connect(daemon.url) as camera:
        camera.start()
        status = camera.calibrate(distance=0.4, frames=2000, bands=False, timeout_s=120)
        assert status["calibrated"]
        camera.start()
        pictures = camera.pictures(timeout_s=WAIT_S)
        picture = next(each for each in pictures if "depth" in each)
        # no pixel of an exposure keeps what was estimated from more photons before
        long, short = camera.expose(480, timeout_s=120), camera.expose(48, timeout_s=120)
        ratio = long.photons.values.sum() / short.photons.values.sum()
        assert ratio == pytest.approx(long.attrs["frames"] / short.attrs["frames"], rel=0.05)
        camera.expose(0, timeout_s=120)
        band_names = picture.band_name.values.tolist()
        assert band_names == [band.name for band in camera.instrument.bands]
        assert picture.depth.dtype == np.float32
        assert picture.quality.dtype == np.uint16
        assert picture.quality.attrs["flag_meanings"].startswith("dead hot")
        row, col = np.argwhere(np.isfinite(picture.depth.values))[0].tolist()
        pixel = camera.pixel(row, col)
        assert pixel["row"] == row
        path = tmp_path / "picture.ply"
        hf.write_image(picture, path)
        assert path.stat().st_size > 0
