"""What the LEDs do during a capture, whoever drives them."""

from __future__ import annotations

from typing import Literal, Protocol

from hueflight.devices.errors import DeviceNotFoundError

CaptureKind = Literal["scene", "reference", "bands", "dark", "flat"]

GUIDANCE: dict[CaptureKind, str] = {
    "scene": "Point the camera at the scene.",
    "reference": "Put a flat white target square to the camera at the distance you state; it must "
    "fill the picture.",
    "bands": "Leave the white target where it is: the LEDs fire one at a time.",
    "dark": "Leave everything as it is: the LEDs stay off.",
    "flat": "Light the target evenly and steadily with a lamp, not with the LEDs.",
}
"""What a person does before a capture."""


class Illumination(Protocol):
    """Drives the LEDs as a capture needs it."""

    name: str

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Have the LEDs fire for a capture; of kind ``"bands"``, each alone for `frames` frames.

        Called before the camera's run begins. Steps are marked in the frames' headers.

        Raises
        ------
        DeviceError
            If the LEDs can't do it.
        """
        ...

    def keep_alive(self) -> None:
        """Feed the board's watchdog; called at least twice a second while a run is on."""
        ...

    def close(self) -> None:
        """Leave the LEDs dark."""
        ...


class NoIllumination:
    """No illuminator is plugged in: LEDs fire as something else has set them."""

    name = "none"

    def prepare(self, kind: CaptureKind, frames: int, /) -> None:
        """Accept what needs nothing switched."""
        if kind in ("bands", "dark"):
            raise DeviceNotFoundError(
                f"capture {kind!r} switches LEDs, but no illuminator is connected: plug it in, or "
                "name its serial port with --illuminator"
            )

    def keep_alive(self) -> None:
        """Nothing to feed."""

    def close(self) -> None:
        """Nothing to switch off."""
