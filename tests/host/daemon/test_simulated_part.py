# SPDX-License-Identifier: Apache-2.0
"""A simulated camera brings its calibration, says what it repeats, and can be unplugged."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from starlette.testclient import TestClient

from hueflight.acquisition.plan import CaptureError
from hueflight.daemon.http.answers import SimulationAnswer
from hueflight.daemon.simulated_part import SimulatedPart
from hueflight.devices.simulation import Changes, Repetition
from hueflight.errors import HueflightError

WAIT_S = 60.0


class Simulation:
    plugged, delay_ps = True, 0.0

    def __init__(self, calibration: Any) -> None:
        self.calibration, self.changes = calibration, Changes()

    def change(self, changes: Changes) -> None:
        self.changes = changes

    def repetition(self) -> Repetition:
        return Repetition(960, 0)

    def calibrate(self, _: Any) -> Any:
        if self.calibration is None:
            raise HueflightError("no photons")
        return self.calibration


class Pictures:
    def __init__(self, calibration: Any = None) -> None:
        self.calibration, self.instrument = calibration, None
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


def test_the_status_is_what_the_description_of_the_api_says() -> None:
    made, _ = part(Simulation(None), Pictures())
    status = made.status()
    assert msgspec.to_builtins(msgspec.convert(status, SimulationAnswer)) == status


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
    made.change(plugged=False)
    assert not simulation.plugged
    still = {"moving": False, "drift_ps_per_s": 0.0, "delay_ps": 0.0, "calibrating": False}
    repeats = {"distinct_frames": 960, "repeated": 0}
    assert made.status() == {"plugged": False, **repeats, **still}
    made.change(plugged=True, moving=True)
    made.change(drift_ps_per_s=5.0)  # what is not named stays as it is
    assert simulation.plugged
    assert simulation.changes == Changes(moving=True, drift_ps_per_s=5.0)
    real, used = part(None, Pictures())
    assert (real.status(), used) == (None, [])
    with pytest.raises(CaptureError, match="not simulated"):
        real.change(plugged=False)


def test_only_a_simulated_camera_is_unplugged_by_request(client: TestClient) -> None:
    answer = client.post("/api/simulation", json={"plugged": False})
    assert answer.status_code == 409
    assert "not simulated" in answer.json()["error"]
    assert client.get("/api/status").json()["simulation"] is None
