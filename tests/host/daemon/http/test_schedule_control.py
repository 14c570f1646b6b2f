# SPDX-License-Identifier: Apache-2.0
"""The schedule of the LEDs: what is set is what they play, and only its own calibration is used."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2
from starlette.testclient import TestClient

import hueflight as hf
from hueflight.recording import open_recording

WAIT_S = 60.0
LATER_NS = 10.0  #: every second band fires so much later, which is eight ticks


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.02)


def status(client: TestClient) -> dict[str, Any]:
    return client.get("/api/status").json()


def depth(client: TestClient) -> float | None:
    """Depth of a pixel, None while it is not known."""
    answer = client.get("/api/pixel?row=1&col=1")
    return answer.json()["depth_m"] if answer.status_code == 200 else None


def depth_is_shown(client: TestClient) -> bool:
    """Whether depth is shown; if so, it must be that of the wall."""
    found = depth(client)
    assert found is None or found == pytest.approx(1.0, abs=0.15)
    return found is not None


@pytest.fixture
def connected(open_daemon: Callable[..., Any]) -> Iterator[TestClient]:
    """A daemon of the whole simulated instrument: camera and LEDs."""
    with open_daemon(rig="simulated:plane?frames=400", requests_per_s=1000, burst=1000) as client:
        until(lambda: status(client)["state"] == "running", "the live run is on")
        yield client


@pytest.fixture
def simulated(connected: TestClient) -> TestClient:
    """The same, when it is calibrated."""
    until(lambda: depth(connected) is not None, "the simulated camera is calibrated")
    return connected


@pytest.fixture
def delays(instrument: hf.Instrument) -> list[float]:
    """Delays of a schedule that is not the instrument's."""
    stated = [band.delays_ns[0] for band in instrument.bands]
    return [delay + LATER_NS * (number % 2) for number, delay in enumerate(stated)]


def recorded(
    client: TestClient, tmp_path: Path, name: str
) -> tuple[hf.Instrument, NDArray[np.int64]]:
    """Instrument and counts of a short recording."""
    client.post("/api/recordings", json={"name": name, "frames": 400})
    until(lambda: status(client)["recording"]["last"].get("name") == name, "it has ended")
    with open_recording(tmp_path / f"data/recordings/{name}.mcap") as recording:
        return recording.instrument, recording.histogram().astype(np.int64)


def p_value(counts: NDArray[np.int64], instrument: hf.Instrument) -> float:
    """Whether the photons of all pixels came as the simulator says for an instrument."""
    scene = hf.simulator.scene("plane", instrument)
    many = hf.simulator.simulate_capture(
        "scene", instrument, frames=60_000, scene=scene, seed=11
    ).astype(np.int64)
    seen, expected = counts[..., 1:].sum((0, 1)), many[..., 1:].sum((0, 1))
    share = seen.sum() / (seen + expected).sum()
    enough = seen + expected > 500
    seen, total = seen[enough], (seen + expected)[enough]
    squares = (seen - share * total) ** 2 / (share * (1 - share) * total)
    return float(chi2.sf(squares.sum(), len(squares) - 1))


def test_leds_fire_as_the_schedule_says(
    connected: TestClient, instrument: hf.Instrument, delays: list[float], tmp_path: Path
) -> None:
    """Photons and the instrument in the recording are those of the schedule."""
    before = status(connected)["fingerprint"]
    answer = connected.post("/api/controls", json={"schedule": {"delays_ns": delays}})
    assert answer.status_code == 200
    set_to = {"delays_ns": [[delay] for delay in delays], "period_ns": 320.0}
    assert answer.json()["schedule"] == set_to
    assert answer.json()["default_schedule"]["delays_ns"][1] == [30.0]
    described, counts = recorded(connected, tmp_path, "later")
    assert [list(band.delays_ns) for band in described.bands] == set_to["delays_ns"]
    assert described.fingerprint() == status(connected)["fingerprint"] != before
    assert connected.get("/api/instrument").json()["fingerprint"] == described.fingerprint()
    assert p_value(counts, instrument) < 1e-12
    assert p_value(counts, described) > 1e-6  # the share of false alarms
    assert connected.post("/api/controls", json={"schedule": None}).json()["schedule"] is None
    described, counts = recorded(connected, tmp_path, "again")
    assert described.fingerprint() == before
    assert p_value(counts, instrument) > 1e-6


@pytest.mark.slow
def test_a_calibration_belongs_to_its_schedule(simulated: TestClient, delays: list[float]) -> None:
    """Depth is shown with a calibration of the same schedule, or not at all."""
    asked = {"distance": 0.4, "frames": 400, "bands": False}
    assert simulated.post("/api/calibration", json=asked).status_code == 200
    changed = simulated.post("/api/controls", json={"schedule": {"delays_ns": delays}})
    assert changed.status_code == 409
    assert "calibration is in progress" in changed.json()["error"]
    until(lambda: status(simulated)["calibration"]["step"] == "done", "it is calibrated")
    kept = status(simulated)["calibration"]["path"]
    simulated.post("/api/controls", json={"schedule": {"delays_ns": delays}})
    assert not depth_is_shown(simulated)
    assert status(simulated)["calibration"]["path"] == ""
    until(lambda: depth_is_shown(simulated), "the simulated camera is calibrated again")
    simulated.post("/api/controls", json={"schedule": None})
    until(lambda: depth_is_shown(simulated), "the calibration that was kept is in use")
    assert status(simulated)["calibration"]["path"] == kept


REFUSED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"delays_ns": [0, 30]}, "the schedule is for 2 bands"),
    ({"delays_ns": [30.0 * k for k in range(8)] + [330]}, "below the period of 320"),
    ({"delays_ns": [30.0 * k for k in range(8)] + [215]}, "coincide"),
    ({"delays_ns": [30.0 * k for k in range(9)], "period_ns": 325}, "whole clocks"),
    ({"delays_ns": [3.0 * k for k in range(9)], "period_ns": 30}, "must be from 40 to 5120"),
    ({"delays_ns": [[0, 50, 100], 10, 20, 30, 40, 60, 70, 80, 90], "period_ns": 160}, "bears"),
    ({"delays_ns": [[0, 60, 120, 180, 240]] + [9.0 * k for k in range(1, 9)]}, "4 a channel"),
    ({"delays_ns": "even"}, "delays_ns"),
    ({"delays_ns": [[]] * 9}, "delays_ns"),
    ({"period_ns": 320}, "delays_ns"),
)


def test_what_the_boards_cannot_play_is_refused(connected: TestClient) -> None:
    before = connected.get("/api/controls").json()
    for schedule, words in REFUSED:
        answer = connected.post("/api/controls", json={"schedule": schedule})
        assert answer.status_code == 422, schedule
        assert words in answer.json()["error"]
    assert connected.get("/api/controls").json() == before
    limits = before["limits"]["schedule"]
    assert limits == {"tick_ns": 1.25, "period_ns": [40.0, 327.5], "pulses": 4}


def test_delays_are_whole_ticks(connected: TestClient) -> None:
    """The answer says what the board plays; the stated schedule is the default one again."""
    stated = [30.0 * k for k in range(9)]
    wanted = [*stated[:8], 241.0]
    answer = connected.post("/api/controls", json={"schedule": {"delays_ns": wanted}})
    assert answer.json()["schedule"]["delays_ns"][8] == [241.25]
    again = connected.post(
        "/api/controls", json={"schedule": {"delays_ns": stated, "period_ns": 320}}
    )
    assert again.json()["schedule"] is None


def test_an_illumination_that_takes_no_schedule_is_left_alone(
    client: TestClient, delays: list[float]
) -> None:
    until(lambda: status(client)["state"] == "running", "the live run is on")
    found = client.get("/api/controls").json()
    assert found["limits"]["schedule"] is None
    answer = client.post("/api/controls", json={"schedule": {"delays_ns": delays}})
    assert answer.status_code == 422
    assert "no illuminator is connected whose schedule" in answer.json()["error"]
    assert status(client)["state"] == "running"
