# SPDX-License-Identifier: Apache-2.0
"""What a simulated camera can be asked besides taking frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hueflight.calibration import Calibration
from hueflight.model.instrument import Instrument


@dataclass(frozen=True)
class Repetition:
    """How far the frames of a simulated camera are photons of their own.

    Attributes
    ----------
    distinct_frames : int or None
        Number of frames that are repeated again and again; None if each frame has new photons.
    repeated : int
        Frames that repeat earlier ones although each should be new, because the machine was too
        busy to draw them.
    """

    distinct_frames: int | None
    repeated: int


@dataclass(frozen=True)
class Changes:
    """What changes in front of a simulated camera.

    Attributes
    ----------
    moving : bool
        Whether a ball moves from side to side in front of the scene.
    drift_ps_per_s : float
        Picoseconds by which all LED light arrives later with every second; 0 takes it back.
    """

    moving: bool = False
    drift_ps_per_s: float = 0.0


class Simulation(Protocol):
    """A simulated camera from its other side.

    Attributes
    ----------
    plugged : bool
        False to have the camera disappear as if its cable were pulled.
    """

    plugged: bool

    @property
    def changes(self) -> Changes:
        """What changes in front of the camera."""
        ...

    @property
    def delay_ps(self) -> float:
        """Present delay of all LED light by drift, in picoseconds."""
        ...

    def change(self, changes: Changes, /) -> None:
        """Let the scene move or delays drift, or end that.

        Raises
        ------
        DeviceError
            If the camera only repeats frames.
        """
        ...

    def repetition(self) -> Repetition:
        """Return how far frames are photons of their own."""
        ...

    def calibrate(self, instrument: Instrument, /) -> Calibration:
        """Return a calibration of an instrument that is simulated; takes some seconds.

        Parameters
        ----------
        instrument : Instrument
            The simulated instrument with the schedule that its LEDs have.

        Returns
        -------
        Calibration
            The calibration.

        Raises
        ------
        HueflightError
            If it can't be made.
        """
        ...
