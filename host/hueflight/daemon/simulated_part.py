# SPDX-License-Identifier: Apache-2.0
"""What the daemon does with a simulated camera besides running it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError
from hueflight.acquisition.runner import Acquisition
from hueflight.calibration import Calibration
from hueflight.daemon.pictures import Pictures
from hueflight.devices.simulation import Simulation
from hueflight.errors import CalibrationError, HueflightError
from hueflight.model.instrument import Instrument

log = structlog.get_logger("hueflight.daemon")
_LOOK_S = 0.1


class SimulatedPart:
    """Calibrates a simulated camera; moves its scene and pulls its cable on demand.

    Parameters
    ----------
    acquisition : Acquisition
        Acquisition that runs the camera.
    pictures : Pictures
        Live pictures, which need to know how many frames are distinct.
    use : callable
        Called with the calibration, unless there is another one by then.

    Attributes
    ----------
    thread : Thread
        Prepares a simulated camera once it is connected, and ends.
    """

    def __init__(
        self,
        acquisition: Acquisition,
        pictures: Pictures,
        /,
        *,
        use: Callable[[Calibration], None],
    ) -> None:
        self._acquisition, self._pictures, self._use = acquisition, pictures, use
        self._closing, self._one_at_a_time = threading.Event(), threading.Lock()
        self._calibrating = False
        self.thread = threading.Thread(target=self._prepare, name="simulation", daemon=True)
        self.thread.start()

    def status(self) -> dict[str, Any] | None:
        """Return how far frames are photons of their own, None for a real camera."""
        simulation = self._acquisition.simulation
        if simulation is None:
            return None
        return {
            "plugged": simulation.plugged,
            **asdict(simulation.repetition()),
            **asdict(simulation.changes),
            "delay_ps": simulation.delay_ps,
            "calibrating": self._calibrating,
        }

    def change(
        self,
        *,
        plugged: bool | None = None,
        moving: bool | None = None,
        drift_ps_per_s: float | None = None,
    ) -> None:
        """Pull the simulated camera's cable or plug it in, move its scene, let its delays drift.

        Parameters
        ----------
        plugged : bool, optional
            False to pull the cable.
        moving : bool, optional
            True to have a ball move in front of the scene.
        drift_ps_per_s : float, optional
            Picoseconds by which LED light arrives later with every second; 0 takes it back. What is
            not given stays as it is.

        Raises
        ------
        CaptureError
            If the camera is not simulated.
        DeviceError
            If the camera repeats frames, in which nothing can move or drift.
        """
        simulation = self._acquisition.simulation
        if simulation is None:
            raise CaptureError("the camera is not simulated: it sees what is in front of it")
        wanted = {"moving": moving, "drift_ps_per_s": drift_ps_per_s}
        changes = {name: value for name, value in wanted.items() if value is not None}
        if changes:
            simulation.change(replace(simulation.changes, **changes))
        if plugged is not None:
            simulation.plugged = plugged
        log.info("simulated camera", plugged=simulation.plugged, **asdict(simulation.changes))

    def close(self) -> None:
        """Do not look for a simulated camera any more."""
        self._closing.set()

    def _prepare(self) -> None:
        while not self._acquisition.snapshot.connections:
            if self._closing.wait(_LOOK_S):
                return
        simulation = self._acquisition.simulation
        if simulation is None:
            return
        self._pictures.limit_frames(simulation.repetition().distinct_frames)
        self._calibrate(simulation)

    def follow_schedule(self) -> None:
        """Calibrate a simulated camera for a schedule that was changed, if nothing fits it."""
        simulation = self._acquisition.simulation
        if simulation is not None:
            threading.Thread(
                target=self._calibrate, args=(simulation,), name="simulation", daemon=True
            ).start()

    def _calibrate(self, simulation: Simulation) -> None:
        with self._one_at_a_time:
            if self._pictures.calibration is None and not self._closing.is_set():
                self._calibrating = True
                self._make_calibration(simulation, self._pictures.instrument)
                self._calibrating = False

    def _make_calibration(self, simulation: Simulation, instrument: Instrument) -> None:
        try:
            calibration = simulation.calibrate(instrument)
        except (HueflightError, OSError) as error:
            if not self._closing.is_set():
                log.error("the simulated camera can't be calibrated", reason=str(error))
            return
        if self._pictures.calibration is not None or self._closing.is_set():
            return
        try:
            self._use(calibration)
        except CalibrationError:
            return  # the schedule was changed meanwhile, and `follow_schedule` was called
        log.info("simulated calibration", distance=calibration.distance)
