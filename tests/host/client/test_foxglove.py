# SPDX-License-Identifier: Apache-2.0
"""Foxglove live: a client written from the protocol's text against the SDK's server and ours."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
pytest.importorskip("google.protobuf", reason="protobuf is not installed (extra dev)")

import foxglove
from foxglove.channels import LogChannel
from foxglove.messages import Log
from websockets.exceptions import ConnectionClosed, InvalidHandshake

import hueflight as hf
from support.daemon_process import Daemon, until
from support.foxglove_client import FoxgloveClient

StartDaemon = Callable[..., Daemon]
TOKEN = "a-token-of-the-tests"
PHOTONS = {"/log", "/tf", "/calibration", "/photons"}


@pytest.fixture(scope="module")
def served(start: StartDaemon, tmp_path_factory: pytest.TempPathFactory) -> Daemon:
    daemon = start(
        tmp_path_factory.mktemp("foxglove"), top="foxglove = true", foxglove_port=0, max_viewers=2
    )
    daemon.post("/api/start")
    return daemon


@pytest.fixture
def client(served: Daemon) -> Iterator[FoxgloveClient]:
    with FoxgloveClient(served.foxglove_url) as made:
        yield made


def plane(message: object) -> np.ndarray:
    kind = {"32FC1": "<f4", "mono16": "<u2", "rgb8": "u1"}[message.encoding]
    return np.frombuffer(message.data, kind).reshape(message.height, message.width, -1).squeeze()


def test_the_client_understands_the_server_of_the_official_sdk() -> None:
    """So that what it reads of our server is what Foxglove's own programs read."""
    context = foxglove.Context()
    server = foxglove.start_server(name="theirs", port=0, context=context)
    try:
        channel = LogChannel("/log", context=context)
        with FoxgloveClient(f"ws://127.0.0.1:{server.port}") as client:
            client.wait_for(lambda: "/log" in client.channels)
            client.subscribe(["/log"])
            deadline = time.monotonic() + 30
            while time.monotonic() < deadline:  # the SDK does not say when it has subscribed
                channel.log(Log(message="hello"), log_time=123)
                try:
                    topic, time_ns, message = client.next_message(timeout_s=0.2)
                    break
                except TimeoutError:
                    continue
            assert (topic, time_ns, message.message) == ("/log", 123, "hello")
    finally:
        server.stop()


def test_channels_are_the_same_as_the_server_of_the_sdk_advertises(
    client: FoxgloveClient,
) -> None:
    context = foxglove.Context()
    server = foxglove.start_server(name="theirs", port=0, context=context)
    try:
        LogChannel("/log", context=context)
        with FoxgloveClient(f"ws://127.0.0.1:{server.port}") as theirs:
            theirs.wait_for(lambda: "/log" in theirs.channels)
            client.wait_for(lambda: "/log" in client.channels)
            expected, found = dict(theirs.channels["/log"]), dict(client.channels["/log"])
            assert found.pop("id") > 0
            expected.pop("id")
            assert found == expected
    finally:
        server.stop()


def test_photons_come_before_a_calibration(client: FoxgloveClient, served: Daemon) -> None:
    client.wait_for(lambda: client.channels.keys() >= PHOTONS)
    client.subscribe(["/photons"])
    topic, time_ns, message = client.next_message()
    assert topic == "/photons"
    assert plane(message).shape == (24, 16)
    assert plane(message).sum() > 0
    assert abs(time.time_ns() - time_ns) < 60e9
    assert message.timestamp.seconds == time_ns // 1_000_000_000
    client.unsubscribe("/photons")
    for _ in range(20):  # those under way still come
        try:
            client.next_message(timeout_s=1.0)
        except TimeoutError:
            break
    else:
        pytest.fail("messages go on")
    assert served.status()["picture"]["number"] > 0


def test_the_log_states_the_status_and_its_changes(client: FoxgloveClient, served: Daemon) -> None:

    def read_until(text: str) -> None:
        for _ in range(20):  # what else happens meanwhile
            if client.next_message()[2].message == text:
                return
        pytest.fail(f"no line {text!r}")

    client.wait_for(lambda: "/log" in client.channels)
    client.subscribe(["/log"])
    read_until("no frames lost")
    served.post("/api/recordings", {"name": "of-the-log", "frames": 1500})
    read_until("recording of-the-log")
    read_until("recording of-the-log ended")


def test_wrong_requests_are_answered_and_do_no_harm(client: FoxgloveClient) -> None:
    client.wait_for(lambda: "/photons" in client.channels)
    for text in (
        "no JSON",
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 999}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "publish"}',
    ):
        client.send(text)
    client.wait_for(lambda: len(client.statuses) == 4)
    assert {status["level"] for status in client.statuses} == {1}
    assert "there is no channel 999" in client.statuses[1]["message"]
    client.subscribe(["/photons"])
    assert client.next_message()[0] == "/photons"


def test_who_may_connect(served: Daemon, client: FoxgloveClient) -> None:
    """Those who offer the subprotocol, are no page of another origin, and find room."""
    url = served.foxglove_url
    with pytest.raises(InvalidHandshake):
        FoxgloveClient(url, subprotocol="other")
    with pytest.raises(InvalidHandshake):
        FoxgloveClient(url, origin="https://evil.example")
    with pytest.raises(InvalidHandshake):
        FoxgloveClient(url + "other")
    with FoxgloveClient(url, subprotocol="foxglove.websocket.v1") as other:
        assert other.subprotocol == "foxglove.websocket.v1"
        with pytest.raises((InvalidHandshake, ConnectionClosed)):
            FoxgloveClient(url)  # a third one, of two that are allowed


def test_the_token_and_allowed_origins(start: StartDaemon, tmp_path: Path) -> None:
    secret = tmp_path / "token"
    secret.write_text(TOKEN)
    secret.chmod(0o600)
    daemon = start(
        tmp_path, top="foxglove = true", foxglove_port=0, token_file=str(secret),
        foxglove_origins=["https://app.foxglove.dev"],
    )  # fmt: skip
    url = daemon.foxglove_url
    for wrong in (url, f"{url}?token=wrong", f"{url}?token={TOKEN}x"):
        with pytest.raises(InvalidHandshake):
            FoxgloveClient(wrong)
    with FoxgloveClient(f"{url}?token={TOKEN}", origin="https://app.foxglove.dev") as client:
        assert client.info["name"] == "hueflight bench"
    with FoxgloveClient(url, additional_headers={"Authorization": f"Bearer {TOKEN}"}) as client:
        assert client.info["capabilities"] == []
    # the daemon's own port keeps its rules
    with pytest.raises(hf.client.TokenError):
        hf.connect(f"{daemon.url}/?token={TOKEN}")
    assert urlsplit(url).port != urlsplit(daemon.url).port


@pytest.mark.slow
def test_while_recording_every_picture_comes_with_the_values_of_the_reconstruction(
    start: StartDaemon, tmp_path: Path
) -> None:
    """All topics of 60 calibrated pictures; no frame is lost; a slow client changes nothing."""
    daemon = start(tmp_path, top="foxglove = true", foxglove_port=0)
    with hf.connect(daemon.url) as camera, FoxgloveClient(daemon.foxglove_url) as client:
        camera.start()
        camera.calibrate(distance=0.4, frames=2000, bands=False, timeout_s=120)
        camera.start()
        bands = [f"{band.wavelength_nm:.0f}nm" for band in camera.instrument.bands]
        planes = ["/depth", "/depth_std", "/quality", *(f"/reflectance/{name}" for name in bands)]
        topics = [*planes, "/color", "/points", "/calibration", "/tf"]
        client.wait_for(lambda: client.channels.keys() >= set(topics))
        with FoxgloveClient(daemon.foxglove_url) as slow:  # subscribes and never reads again
            slow.wait_for(lambda: slow.channels.keys() >= set(topics))
            slow.subscribe(topics)
            name = camera.record(frames=1200)
            client.subscribe(topics)
            got: dict[str, dict[int, object]] = {topic: {} for topic in topics}
            pictures = {}
            exact = camera.pictures("all", timeout_s=60)
            while len(got["/tf"]) < 60:
                topic, time_ns, message = client.next_message()
                got[topic][time_ns] = message
                if topic == "/tf" and len(pictures) < 40:
                    picture = next(exact)
                    pictures[round(picture.attrs["received_unix_s"], 3)] = picture
            summary = camera.wait_for_recording(name, timeout_s=60)
    assert summary["recorded_frames"] == 1200
    assert sum(daemon.status()["lost"].values()) == 0
    times = [set(found) for found in got.values()]
    complete = set.intersection(*times)
    assert len(complete) >= 58  # the first and the last may be cut
    same = [(when, pictures[key]) for when in complete if (key := round(when / 1e9, 3)) in pictures]
    assert len(same) >= 5
    for when, picture in same:
        for variable in ("depth", "depth_std", "quality"):
            found = plane(got[f"/{variable}"][when])
            assert np.array_equal(found, picture[variable].values, equal_nan=True)
        for number, band in enumerate(bands):
            found = plane(got[f"/reflectance/{band}"][when])
            wanted = picture.reflectance.isel(band=number).values
            assert np.array_equal(found, wanted, equal_nan=True)
        cloud = got["/points"][when]
        count = len(cloud.data) // cloud.point_stride
        assert count == np.isfinite(picture.depth.values).sum() > 0
        assert {"quality", *(f"reflectance_{band}" for band in bands)} <= {
            field.name for field in cloud.fields
        }
        assert plane(got["/color"][when]).max() > 100


def test_a_client_that_does_not_read_is_left_behind(served: Daemon) -> None:
    """Pictures go on being made for others while one client's connection is full."""
    with FoxgloveClient(served.foxglove_url) as client:
        client.wait_for(lambda: "/photons" in client.channels)
        client.subscribe(["/photons"])
        client.next_message()
        before = served.status()["picture"]["number"]
        until(lambda: served.status()["picture"]["number"] > before + 30, "pictures")
        assert sum(served.status()["lost"].values()) == 0
