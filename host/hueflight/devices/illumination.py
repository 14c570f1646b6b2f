# SPDX-License-Identifier: Apache-2.0
"""Illumination of captures: what the LEDs do, whichever device drives them."""

from __future__ import annotations

from typing import Literal, Protocol, runtime_checkable

from hueflight.devices.errors import DeviceNotFoundError
from hueflight.devices.pulse_schedule import Capacity
from hueflight.model.instrument import Instrument

CaptureKind = Literal["scene", "reference", "bands", "dark", "flat"]

GUIDANCE: dict[CaptureKind, str] = {
    "scene": "Point the camera at the scene.",
    "reference": "Put a flat white target square to the camera at the distance you state; it must "
    "fill the picture.",
    "bands": "Leave the white target where it is: the LEDs fire one at a time.",
    "dark": "Leave everything as it is: the LEDs stay off.",
    "flat": "Light the target evenly and steadily with a lamp, not with the LEDs.",
}
"""What a person has to do before a capture of each kind."""


class Illumination(Protocol):
    """Drives the LEDs as a capture needs it.

    Attributes
    ----------
    name : str
        Name for people, such as the serial port of the illuminator.
    """

    name: str

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Set the LEDs up for a capture, before the camera's run begins.

        Parameters
        ----------
        kind : CaptureKind
            What the capture is for. For ``"bands"`` the LEDs fire one at a time, and the marker
            in the headers of the frames is the number of the LED.
        frames : int
            Number of frames for each LED of a capture of kind ``"bands"``.

        Raises
        ------
        DeviceError
            If the LEDs can't do it.
        """
        ...

    def keep_alive(self) -> None:
        """Feed the board's watchdog; called at least twice a second during a run."""
        ...

    def close(self) -> None:
        """Turn the LEDs off and release the device."""
        ...


@runtime_checkable
class ScheduledIllumination(Illumination, Protocol):
    """Illumination whose pulse schedule can be changed between runs."""

    @property
    def capacity(self) -> Capacity:
        """Limits of the schedules that it plays."""
        ...

    def load_schedule(self, instrument: Instrument, /) -> None:
        """Play the schedule that an instrument states from the next `prepare` on.

        Parameters
        ----------
        instrument : Instrument
            States the delays of the bands and the period.

        Raises
        ------
        DeviceError
            If the LEDs can't do it, or the device does not answer.
        """
        ...


class NoIllumination:
    """Stands for a missing illuminator: something else drives the LEDs."""

    name = "none"

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Accept a capture that needs no LEDs switched.

        Parameters
        ----------
        kind : CaptureKind
            What the capture is for.
        frames : int
            Number of frames for each LED; not used.

        Raises
        ------
        DeviceNotFoundError
            If the capture needs LEDs switched.
        """
        if kind in ("bands", "dark"):
            raise DeviceNotFoundError(
                f"capture {kind!r} switches LEDs, but no illuminator is connected: plug it in, or "
                "name its serial port with --illuminator"
            )

    def keep_alive(self) -> None:
        """Do nothing: there is no watchdog."""

    def close(self) -> None:
        """Do nothing: there is no LED to turn off."""
