# SPDX-License-Identifier: Apache-2.0
"""A simulated camera brings its calibration, says what it repeats, and can be unplugged."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

from hueflight.acquisition.plan import CaptureError
from hueflight.daemon.simulated_part import SimulatedPart
from hueflight.devices.simulation import Repetition
from hueflight.errors import HueflightError

WAIT_S = 20.0


class Simulation:
    plugged = True

    def __init__(self, calibration: Any) -> None:
        self.calibration = calibration

    def repetition(self) -> Repetition:
        return Repetition(960, 0)

    def calibrate(self) -> Any:
        if self.calibration is None:
            raise HueflightError("no photons")
        return self.calibration


class Pictures:
    def __init__(self, calibration: Any = None) -> None:
        self.calibration = calibration
        self.limits: list[int | None] = []

    def limit_frames(self, distinct_frames: int | None) -> None:
        self.limits.append(distinct_frames)


def part(simulation: Simulation | None, pictures: Pictures) -> tuple[SimulatedPart, list[Any]]:
    """The part of a camera that is connected, when it has done its work; calibrations in use."""
    used: list[Any] = []
    snapshot = SimpleNamespace(connections=1)
    acquisition = SimpleNamespace(snapshot=snapshot, simulation=simulation)
    made = SimulatedPart(acquisition, pictures, use=used.append)  # type: ignore[arg-type]
    deadline = time.monotonic() + WAIT_S
    while made.thread.is_alive():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return made, used


def test_a_calibration_comes_along_unless_there_is_one() -> None:
    wanted = SimpleNamespace(distance=0.4)
    pictures = Pictures()
    _, used = part(Simulation(wanted), pictures)
    assert (used, pictures.limits) == ([wanted], [960])
    _, used = part(Simulation(wanted), Pictures(calibration="of the user"))
    assert used == []
    _, used = part(Simulation(None), Pictures())  # it can't be made, which the log says
    assert used == []


def test_the_cable_of_a_simulated_camera() -> None:
    simulation = Simulation(SimpleNamespace(distance=0.4))
    made, _ = part(simulation, Pictures())
    made.plug(False)
    assert not simulation.plugged
    assert made.status() == {"plugged": False, "distinct_frames": 960, "repeated": 0}
    real, used = part(None, Pictures())
    assert (real.status(), used) == (None, [])
    with pytest.raises(CaptureError, match="not simulated"):
        real.plug(False)


def test_only_a_simulated_camera_is_unplugged_by_request(client: TestClient) -> None:
    answer = client.post("/api/simulation", json={"plugged": False})
    assert answer.status_code == 409
    assert "not simulated" in answer.json()["error"]
    assert client.get("/api/status").json()["simulation"] is None
