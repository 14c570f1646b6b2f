# SPDX-License-Identifier: Apache-2.0
"""Several daemons as one: listed, and started and recorded together."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hueflight as hf
from hueflight.acquisition.plan import CaptureError
from hueflight.client.address import Address
from hueflight.client.requests import Requests
from hueflight.daemon.cameras import Cameras
from hueflight.daemon.config import MOST_CAMERAS, ConfigError, DaemonConfig
from hueflight.daemon.server_config import CameraConfig


class Answered(Requests):
    """Requests that a function carries out, given the daemon's address, method, path and body."""

    def __init__(self, address: Address, answer: Callable[..., Any]) -> None:
        super().__init__(address, token=None, timeout_s=1.0)
        self._answer = answer

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        return self._answer(self.address.netloc, method, path, body)


def three(answer: Callable[..., Any]) -> Cameras:
    """This daemon and two others, whose requests `answer` carries out."""
    made = Cameras((CameraConfig(address="one"), CameraConfig(address="https://two.example")))
    made.others = [Answered(other.address, answer) for other in made.others]
    return made


def test_all_are_asked_at_the_same_time() -> None:
    """No answer comes before all three requests were sent."""
    together = threading.Barrier(3, timeout=20)
    asked = []

    def answer(where: str, method: str, path: str, body: Any) -> dict[str, Any]:
        together.wait()
        asked.append((where, method, path, body))
        return {"name": where}

    found = three(answer).act("record", {"frames": 5}, lambda *of: answer("own", *of))
    assert [each["address"] for each in found["cameras"]] == ["", "one:8470", "two.example:443"]
    assert [each["name"] for each in found["cameras"]] == [
        "own", "one:8470", "two.example:443",
    ]  # fmt: skip
    assert found["within_s"] > 0
    expected = {
        (name, "POST", "/api/recordings") for name in ("own", "one:8470", "two.example:443")
    }
    assert {each[:3] for each in asked} == expected
    assert all(each[3] == {"frames": 5} for each in asked)


def test_one_that_fails_does_not_stop_the_others() -> None:
    def answer(where: str, *_: Any) -> dict[str, Any]:
        if where == "one:8470":
            raise CaptureError("a recording is in progress")
        return {}

    cameras = three(answer)
    found = cameras.act("start", None, lambda *_: answer("own"))["cameras"]
    assert [each["error"] for each in found] == ["", "a recording is in progress", ""]
    listed = cameras.listing(lambda *_: answer("own"))
    assert [each["instrument"] for each in listed] == [{}, None, {}]


def test_a_daemon_that_is_not_there(open_daemon: Any) -> None:
    with open_daemon(cameras=(CameraConfig(address="127.0.0.1:9"),)) as client:
        own, other = client.get("/api/cameras").json()["cameras"]
        assert own["instrument"]["rows"] == 6
        assert (other["address"], other["instrument"]) == ("127.0.0.1:9", None)
        assert "no daemon can be reached" in other["error"]
        answer = client.post("/api/cameras", json={"action": "record", "name": "both", "frames": 9})
        first, second = answer.json()["cameras"]
        assert (first["name"], first["error"]) == ("both", "")
        assert "no daemon can be reached" in second["error"]
        assert client.post("/api/cameras", json={"action": "dance"}).status_code == 422


def test_tables_of_cameras(tmp_path: Path) -> None:
    path = tmp_path / "daemon.toml"
    path.write_text('[[cameras]]\naddress = "localhost:8471"\n')
    assert DaemonConfig.load(path).cameras == (CameraConfig(address="localhost:8471"),)
    path.write_text("[[cameras]]\naddress = 'x'\n" * (MOST_CAMERAS + 1))
    with pytest.raises(ConfigError, match="at most"):
        DaemonConfig.load(path)
    with pytest.raises(hf.HueflightError, match="no address"):
        Cameras((CameraConfig(address="ftp://x"),))
    token = tmp_path / "token"
    token.write_text("short")
    token.chmod(0o600)
    with pytest.raises(ConfigError, match="must be at least"):
        Cameras((CameraConfig(address="x", token_file=str(token)),))
