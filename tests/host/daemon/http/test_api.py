# SPDX-License-Identifier: Apache-2.0
"""The API: what it does, and whom it does not let in."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

import hueflight as hf
from hueflight.daemon.http.client_socket import MESSAGES_PER_S
from hueflight.daemon.http.operations import OPERATIONS
from hueflight.emulation.frame_bank import FrameBank
from hueflight.recording import open_recording
from hueflight.recording.layout import segment_path
from hueflight.simulator import simulate_capture, simulate_packets

OpenDaemon = Callable[..., Any]
BASE = "http://127.0.0.1:8470"
LIVE = "ws://127.0.0.1:8470/api/live"
WAIT_S = 60.0


@contextmanager
def viewing(client: TestClient, **options: Any) -> Iterator[WebSocketTestSession]:
    """An open live socket; the test client cancels the application when it is closed."""
    with suppress(CancelledError), client.websocket_connect(LIVE, **options) as socket:
        yield socket


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.02)


def status(client: TestClient) -> dict[str, Any]:
    return client.get("/api/status").json()


def test_live_recording_and_the_end(client: TestClient, tmp_path: Path) -> None:
    until(lambda: status(client)["kind"] == "live", "the live run is on")
    assert status(client)["simulated"] is True
    answer = client.post("/api/recordings", json={"name": "one", "frames": 300})
    assert answer.json() == {"name": "one"}
    until(lambda: bool(status(client)["recording"]["last"]), "the recording is finished")
    last = status(client)["recording"]["last"]
    assert (last["recorded_frames"], last["failure"]) == (300, "")
    assert sum(last["lost"].values()) == 0
    with open_recording(tmp_path / "data/recordings/one.mcap") as recording:
        assert (recording.histogram().sum(axis=-1) <= 300).all()
    listed = client.get("/api/recordings").json()["recordings"]
    assert [entry["name"] for entry in listed] == ["one"]
    assert client.post("/api/stop").status_code == 200
    until(lambda: status(client)["state"] == "idle", "the live run has ended")
    found = status(client)
    assert found["totals"]["exposed"] == found["totals"]["delivered"]
    assert client.post("/api/start").status_code == 200
    until(lambda: status(client)["state"] == "running", "it runs again")


def recorded(client: TestClient, name: str, **body: Any) -> dict[str, Any]:
    """A finished recording as it is listed."""
    assert client.post("/api/recordings", json={"name": name, **body}).status_code == 200
    until(lambda: status(client)["recording"]["last"].get("name") == name, "it has ended")
    until(lambda: listed(client)[name]["finished"], "it is finished")
    return listed(client)[name]


def listed(client: TestClient) -> dict[str, dict[str, Any]]:
    return {entry["name"]: entry for entry in client.get("/api/recordings").json()["recordings"]}


def test_the_list_says_what_is_in_each_recording(client: TestClient, tmp_path: Path) -> None:
    found = recorded(client, "one", frames=400, note="a vase")
    assert (found["frames"], found["kind"], found["note"]) == (400, "scene", "a vase")
    assert found["lost"] == {"sensor": 0, "fpga": 0, "usb": 0, "host": 0, "disk": 0}
    assert 0.2 <= found["seconds"] < WAIT_S  # 400 frames at 2000 a second
    assert (found["gaps"], found["failure"], found["calibration"]) == (0, "", "")
    with open_recording(tmp_path / "data/recordings/one.mcap") as recording:
        assert found["frames"] == recording.frames
        began = datetime.fromisoformat(recording.info().started)
    # the run begins with the file; the clock of the machine may be adjusted meanwhile
    assert abs((datetime.fromisoformat(found["started"]) - began).total_seconds()) < WAIT_S
    (tmp_path / "data/recordings/foreign.mcap").write_bytes(b"")
    (tmp_path / "data/recordings/foreign.json").write_text("[1]")
    unknown = listed(client)["foreign"]
    assert (unknown["frames"], unknown["seconds"], unknown["lost"]) == (None, None, None)


def test_recordings_are_renamed_and_deleted(client: TestClient, tmp_path: Path) -> None:
    folder = tmp_path / "data/recordings"
    before = recorded(client, "one", frames=100)
    segment_path(folder / "one.mcap", 1).write_bytes(b"later")
    recorded(client, "two", frames=100)
    here = "/api/recordings/one"
    assert client.patch(here, json={"name": "two"}).status_code == 409
    assert client.patch(here, json={"name": "../x"}).status_code == 422
    assert client.patch("/api/recordings/none", json={"name": "x"}).status_code == 404
    assert client.delete("/api/recordings/none").status_code == 404
    assert client.delete("/api/recordings/..%2ftwo").status_code in (404, 405, 409)
    assert client.patch(here, json={"name": "other"}).json() == {"name": "other"}
    found = listed(client)
    assert set(found) == {"other", "two"}
    assert (found["other"]["frames"], found["other"]["segments"]) == (before["frames"], 2)
    assert segment_path(folder / "other.mcap", 1).read_bytes() == b"later"
    assert json.loads((folder / "other.json").read_text())["name"] == "other"
    assert client.delete("/api/recordings/other").json() == {"name": "other"}
    assert {path.name for path in folder.iterdir()} == {"two.mcap", "two.json"}


def test_a_recording_in_progress_is_neither_renamed_nor_deleted(client: TestClient) -> None:
    recorded(client, "done", frames=10)
    client.post("/api/recordings", json={"name": "busy"})
    for answer in (
        client.delete("/api/recordings/busy"),
        client.patch("/api/recordings/busy", json={"name": "x"}),
        client.patch("/api/recordings/done", json={"name": "busy"}),
    ):
        assert answer.status_code == 409
        assert "'busy' is in progress" in answer.json()["error"]
    client.post("/api/recordings/stop")


def test_an_open_recording_is_stopped_by_hand(client: TestClient) -> None:
    assert client.post("/api/recordings/stop").status_code == 409
    name = client.post("/api/recordings", json={}).json()["name"]
    again = client.post("/api/recordings", json={"name": "two"})
    assert again.status_code == 409
    assert f"recording '{name}' is in progress" in again.json()["error"]
    until(lambda: status(client)["kind"] == "scene", "it has begun")
    assert client.post("/api/recordings/stop").json() == {"name": name}
    until(lambda: not status(client)["recording"]["name"], "it has ended")
    assert client.post("/api/recordings", json={"name": name}).status_code == 409


def test_a_recording_stopped_before_it_began_is_none(client: TestClient) -> None:
    """Whichever thread is first, the recording ends."""
    for number in range(5):
        client.post("/api/recordings", json={"name": f"short{number}"})
        assert client.post("/api/recordings/stop").status_code == 200
        until(lambda: not status(client)["recording"]["name"], "it has ended")


def test_a_pixel(client: TestClient) -> None:
    until(lambda: status(client)["picture"]["number"] > 0, "there is a picture")
    found = client.get("/api/pixel", params={"row": 5, "col": 7}).json()
    assert sum(found["counts"]) == found["photons"]
    assert len(found["edges_ns"]) == len(found["counts"]) + 1
    assert found["depth_m"] is None
    outside = client.get("/api/pixel", params={"row": 6, "col": 0})
    assert outside.status_code == 404
    assert "outside the picture of 6 × 8" in outside.json()["error"]


def test_a_map_that_is_not_configured(client: TestClient) -> None:
    assert client.get("/api/instrument").json()["materials"] == {}
    refused = client.get("/api/materials", params={"name": "abundance_red"})
    assert refused.status_code == 404
    assert "not configured in the table [materials]" in refused.json()["error"]


@pytest.mark.parametrize(
    ("body", "status_code", "words"),
    [
        (b'{"name": "../../x"}', 422, "name"),
        (b'{"name": "a/b"}', 422, "name"),
        (b'{"frames": -1}', 422, "frames"),
        (b'{"frames": "many"}', 422, "frames"),
        (b'{"path": "/etc/x"}', 422, "path"),
        (b'{"kind": "bands"}', 409, "how many for each LED"),
        (b"{", 400, "not valid JSON"),
        (b"\xff\xfe", 400, "not valid JSON"),
        (b"[" * 5000, 422, "Expected `object`"),
    ],
)
def test_bad_bodies_are_refused(
    client: TestClient, body: bytes, status_code: int, words: str
) -> None:
    headers = {"content-type": "application/json"}
    answer = client.post("/api/recordings", content=body, headers=headers)
    assert answer.status_code == status_code
    assert words in answer.json()["error"]
    assert client.get("/api/recordings").json() == {"recordings": []}


def test_pictures_are_made_as_clients_want_them(client: TestClient) -> None:
    found = status(client)["picture"]
    assert (found["integration_s"], found["method"]) == (None, "joint")  # None: no limit
    until(lambda: status(client)["picture"]["frames"]["least"] > 2000, "photons add up")
    answer = client.post("/api/picture", json={"integration_s": 0, "method": "pooled"})
    assert answer.json().items() >= {"integration_s": 0.0, "method": "pooled"}.items()
    until(lambda: status(client)["picture"]["frames"]["most"] == 400, "the newest frames only")
    answer = client.post("/api/picture", json={"integration_s": None})
    assert answer.json().items() >= {"integration_s": None, "method": "pooled"}.items()
    assert status(client)["picture"]["integration_s"] is None
    answer = client.post("/api/picture", json={"frames": 900})
    assert answer.json()["integration_s"] == 0
    until(lambda: status(client)["picture"]["frames"]["most"] == 1000, "as many as were asked for")
    assert client.post("/api/picture", json={"frames": 0}).json()["integration_s"] is None
    answer = client.post("/api/picture", json={"method": "magic"})
    assert answer.status_code == 422
    assert "method = 'magic'" in answer.json()["error"]
    assert client.post("/api/picture", json={"integration_s": -1}).status_code == 422


def test_bodies_must_be_json_and_small(client: TestClient) -> None:
    assert client.post("/api/recordings", data={"name": "x"}).status_code == 415
    headers = {"content-type": "application/json"}
    large = client.post("/api/recordings", content=b" " * 100_000, headers=headers)
    assert large.status_code == 413

    def trickle() -> Any:
        for _ in range(100):
            yield b" " * 1000

    chunked = client.post("/api/recordings", content=trickle(), headers=headers)
    assert chunked.status_code == 413


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1:1", "127.0.0.1", "a:b:c", ""])
def test_other_hosts_are_refused(client: TestClient, host: str) -> None:
    """A page that points its own name at 127.0.0.1 (DNS rebinding) says so in Host."""
    assert client.get("/api/status", headers={"host": host}).status_code == 421


def test_other_origins_are_refused(client: TestClient) -> None:
    for headers in (
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ):
        assert client.post("/api/stop", headers=headers).status_code == 403
        with (
            pytest.raises(WebSocketDisconnect) as refused,
            client.websocket_connect(LIVE, headers=headers),
        ):
            pass
        assert refused.value.code == 1008
    own = {"origin": BASE, "sec-fetch-site": "same-origin"}
    assert client.post("/api/start", headers=own).status_code == 200


def test_without_the_token_nothing_but_the_page(open_daemon: OpenDaemon) -> None:
    with open_daemon(token="0123456789abcdef") as client:
        for path in ("/api/status", "/metrics", "/openapi.json", "/api/pixel?row=0&col=0"):
            assert client.get(path).status_code == 401
            wrong = {"authorization": "Bearer 0123456789abcdeg"}
            assert client.get(path, headers=wrong).status_code == 401
        right = {"authorization": "Bearer 0123456789abcdef"}
        assert client.get("/api/status", headers=right).status_code == 200
        for path in ("/", "/main.js", "/health"):
            assert client.get(path).status_code == 200
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE):
            pass
        protocols = ["hueflight.v1", "hueflight.token.0123456789abcdef"]
        with viewing(client, subprotocols=protocols) as socket:
            assert socket.accepted_subprotocol == "hueflight.v1"


def test_floods_are_turned_away(open_daemon: OpenDaemon) -> None:
    with open_daemon(requests_per_s=1, burst=10) as client:
        answers = [client.get("/api/recordings").status_code for _ in range(30)]
        assert answers[:10] == [200] * 10
        assert answers.count(429) >= 15


def test_viewers_are_bounded(open_daemon: OpenDaemon) -> None:
    with (
        open_daemon(max_viewers=1) as client,
        viewing(client),
        pytest.raises(WebSocketDisconnect) as refused,
        client.websocket_connect(LIVE),
    ):
        pass
    assert refused.value.code == 1013


def test_a_viewer_gets_pictures_and_the_status(client: TestClient) -> None:
    until(lambda: status(client)["picture"]["number"] > 0, "there is a picture")
    with viewing(client) as socket:
        seen = {"bytes": 0, "text": 0}
        for _ in range(12):
            message = socket.receive()
            kind = "bytes" if message.get("bytes") else "text"
            seen[kind] += 1
            if kind == "bytes":
                size = int.from_bytes(message["bytes"][:4], "little")
                number = int(message["bytes"][4 : 4 + size].split(b'"number":')[1].split(b",")[0])
                socket.send_text(f'{{"shown": {number}}}')
        assert min(seen.values()) >= 1
    until(lambda: status(client)["viewers"] == 0, "the viewer is gone")
    assert status(client)["latency_s"]["p50"] > 0


@pytest.mark.parametrize("said", ["{", "[]", '{"shown": "x"}', '{"other": 1}', ""])
def test_a_viewer_that_talks_nonsense_is_let_go(client: TestClient, said: str) -> None:
    with client.websocket_connect(LIVE) as socket:
        socket.send_text(said)
        assert end_of(socket)["code"] == 1008


def test_a_viewer_that_sends_too_much_is_let_go(client: TestClient) -> None:
    with client.websocket_connect(LIVE) as socket:
        for _ in range(10 * MESSAGES_PER_S):
            socket.send_text('{"shown": 0}')
        assert end_of(socket)["code"] == 1008


def end_of(socket: WebSocketTestSession) -> Any:
    """The message that closes a live socket, after some others."""
    messages = (socket.receive() for _ in range(100))
    return next(message for message in messages if message["type"] == "websocket.close")


def test_every_operation_is_described(client: TestClient) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    for operation in OPERATIONS:
        assert paths[operation.path][operation.method.lower()]["operationId"] == operation.name


def test_answers_forbid_what_pages_should_not_do(client: TestClient) -> None:
    headers = client.get("/").headers
    assert "default-src 'none'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert client.get("/api/status").headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    "path", ["/..%2f..%2fetc/passwd", "/../service.py", "/%2e%2e/app.py", "/service.py"]
)
def test_only_the_files_of_the_page_are_served(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404


def test_metrics_and_health(client: TestClient) -> None:
    until(lambda: status(client)["state"] == "running", "the live run is on")
    text = client.get("/metrics").text
    assert 'hueflight_frames_lost_total{place="usb"} 0.0' in text
    assert 'hueflight_thread_cpu_seconds_total{thread="acquisition"}' in text
    assert client.get("/health").json() == {"healthy": True, "state": "running", "problems": []}


def test_what_is_to_be_known_needs_a_calibration(client: TestClient) -> None:
    answer = client.post("/api/recordings", json={"name": "known", "until_depth_std": 0.01})
    assert answer.status_code == 409
    assert "no calibration" in answer.json()["error"]
    assert not status(client)["recording"]["name"]
    wrong = client.post("/api/recordings", json={"until_depth_std": 0.01, "share": 0})
    assert wrong.status_code == 422


def test_a_recording_ends_when_enough_is_known(
    open_daemon: Callable[..., Any], instrument: hf.Instrument, tmp_path: Path
) -> None:
    reference = simulate_capture("reference", instrument, frames=20_000)
    kept = tmp_path / "data/calibrations/earlier/calibration.zarr"
    kept.parent.mkdir(parents=True)
    hf.calibrate(reference, instrument, distance=0.4).save(kept)
    # light of a target: without a return no reflectance is known, however long it lasts
    bank = FrameBank(simulate_packets("reference", instrument, frames=512))
    with open_daemon(bank=bank, requests_per_s=1000, burst=1000) as client:
        wish = {"name": "known", "until_reflectance_std": 1.0, "share": 0.5}
        assert client.post("/api/recordings", json=wish).status_code == 200
        until(lambda: bool(status(client)["recording"]["last"]), "the recording has ended")
        last = status(client)["recording"]["last"]
    assert last["failure"] == ""
    assert last["share_known"] >= 0.5
    assert last["recorded_frames"] > 0


def test_the_calibration_in_use_is_checked(
    open_daemon: Callable[..., Any], instrument: hf.Instrument, tmp_path: Path
) -> None:
    reference = simulate_capture("reference", instrument, frames=20_000)
    kept = tmp_path / "data/calibrations/earlier/calibration.zarr"
    kept.parent.mkdir(parents=True)
    hf.calibrate(reference, instrument, distance=0.4).save(kept)
    bank = FrameBank(simulate_packets("reference", instrument, frames=512))
    with open_daemon(bank=bank, requests_per_s=1000, burst=1000) as client:
        until(lambda: status(client)["state"] == "running", "the live run is on")
        assert client.post("/api/check/correct").status_code == 409  # none was offered
        wish = {"kind": "reference", "frames": 500}  # fewer than are simulated: none comes twice
        assert client.post("/api/check", json=wish).json() == {"step": "capture"}
        until(lambda: status(client)["check"]["step"] in ("done", "failed"), "it is checked")
        found = status(client)["check"]
        assert found["kind"] == "reference"
        assert found["step"] == "done"
        assert "calibration" in found["message"]
        until(lambda: status(client)["state"] == "running", "the live run is on again")


def test_a_check_needs_a_calibration(client: TestClient) -> None:
    answer = client.post("/api/check", json={})
    assert answer.status_code == 409
    assert "calibrate first" in answer.json()["error"]
    assert client.post("/api/check", json={"kind": "dark"}).status_code == 422


def test_pages_of_other_sites_do_not_spend_the_budget_of_the_user(open_daemon: OpenDaemon) -> None:
    with open_daemon(requests_per_s=1, burst=10) as client:
        foreign = {"origin": "http://evil.example"}
        answers = [client.get("/api/status", headers=foreign).status_code for _ in range(30)]
        assert answers[0] == 403
        assert answers.count(429) >= 15
        assert client.get("/api/status").status_code == 200


def test_a_calibration_is_not_disturbed_and_can_be_cancelled(client: TestClient) -> None:
    until(lambda: status(client)["state"] == "running", "the live run is on")
    wish = {"distance": 0.4, "frames": 1_000_000}
    assert client.post("/api/calibration", json=wish).status_code == 200
    until(lambda: status(client)["kind"] == "reference", "the first capture is taken")
    until(lambda: status(client)["calibration"]["progress"]["frames"] > 100, "frames are taken")
    progress = status(client)["calibration"]["progress"]
    bands = len(client.get("/api/instrument").json()["bands"])
    assert progress["of_frames"] == 1_000_000 * (1 + bands)
    left = (progress["of_frames"] - progress["frames"]) / 2000.0
    assert progress["seconds_left"] == pytest.approx(left)
    for path, body in (
        ("/api/recordings", {}), ("/api/stop", None), ("/api/start", None),
        ("/api/calibration", wish),
    ):  # fmt: skip
        answer = client.post(path, json=body)
        assert answer.status_code == 409, path
        assert "a calibration is in progress" in answer.json()["error"]
    assert client.post("/api/calibration/cancel").status_code == 200
    until(lambda: status(client)["calibration"]["step"] == "cancelled", "it is cancelled")
    until(lambda: status(client)["calibration"]["progress"] is None, "it is over")
    assert "none in use" in status(client)["calibration"]["message"]
    assert client.post("/api/calibration/cancel").status_code == 409
    assert client.post("/api/recordings", json={"name": "next"}).status_code == 200
    assert client.post("/api/calibration", json=wish).status_code == 409
