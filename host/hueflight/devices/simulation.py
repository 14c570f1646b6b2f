# SPDX-License-Identifier: Apache-2.0
"""What a simulated camera can be asked besides taking frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hueflight.calibration import Calibration


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


class Simulation(Protocol):
    """A simulated camera from its other side.

    Attributes
    ----------
    plugged : bool
        False to have the camera disappear as if its cable were pulled.
    """

    plugged: bool

    def repetition(self) -> Repetition:
        """Return how far frames are photons of their own."""
        ...

    def calibrate(self) -> Calibration:
        """Return a calibration of the simulated instrument; takes some seconds.

        Raises
        ------
        HueflightError
            If it can't be made.
        """
        ...
