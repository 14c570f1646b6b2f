# SPDX-License-Identifier: Apache-2.0
"""What the daemon does with a simulated camera besides running it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import structlog

from hueflight.acquisition.plan import CaptureError
from hueflight.acquisition.runner import Acquisition
from hueflight.calibration import Calibration
from hueflight.daemon.pictures import Pictures
from hueflight.devices.simulation import Simulation
from hueflight.errors import HueflightError

log = structlog.get_logger("hueflight.daemon")
_LOOK_S = 0.1


class SimulatedPart:
    """Calibrates a simulated camera at the start, and pulls its cable on demand.

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
        self._closing = threading.Event()
        self.thread = threading.Thread(target=self._prepare, name="simulation", daemon=True)
        self.thread.start()

    def status(self) -> dict[str, Any] | None:
        """Return how far frames are photons of their own, None for a real camera."""
        simulation = self._acquisition.simulation
        if simulation is None:
            return None
        return {"plugged": simulation.plugged, **asdict(simulation.repetition())}

    def plug(self, plugged: bool, /) -> None:
        """Pull the simulated camera's cable, or plug it in.

        Parameters
        ----------
        plugged : bool
            False to pull it.

        Raises
        ------
        CaptureError
            If the camera is not simulated.
        """
        simulation = self._acquisition.simulation
        if simulation is None:
            raise CaptureError("the camera is not simulated: only its own cable unplugs it")
        simulation.plugged = plugged
        log.info("simulated camera", plugged=plugged)

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
        if self._pictures.calibration is None:
            self._calibrate(simulation)

    def _calibrate(self, simulation: Simulation) -> None:
        try:
            calibration = simulation.calibrate()
        except (HueflightError, OSError, RuntimeError) as error:  # RuntimeError: the program ends
            if not self._closing.is_set():
                log.error("the simulated camera can't be calibrated", reason=str(error))
            return
        if self._pictures.calibration is None and not self._closing.is_set():
            self._use(calibration)
            log.info("simulated calibration", distance=calibration.distance)
