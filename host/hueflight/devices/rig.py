"""A rig: one camera and its lights, found on the ports or simulated."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hueflight.devices.errors import DeviceError
from hueflight.devices.lights import Lights, NoLights
from hueflight.instrument import Instrument

if TYPE_CHECKING:
    from hueflight.devices.camera import Camera


@dataclass(frozen=True)
class Rig:
    """What a capture needs.

    Attributes
    ----------
    camera, lights : the boards.
    """

    camera: Camera
    lights: Lights

    @property
    def simulated(self) -> bool:
        """Whether the photons are."""
        return self.camera.simulated

    def close(self) -> None:
        """LEDs dark, ports given back."""
        with contextlib.suppress(DeviceError):  # if it is gone, its watchdog turns the LEDs off
            self.lights.close()
        self.camera.close()


Connect = Callable[[], Rig]
"""Opens a rig; raises `DeviceError` while there is none."""


def hardware(serial: str | None = None) -> Connect:
    """How to open the camera with a serial number, or the only one plugged in."""

    def connect() -> Rig:
        try:
            from hueflight.devices.usb import open_camera
        except ImportError as error:
            raise DeviceError(
                f"cameras need the package {error.name}: install hueflight[devices], or use "
                "--simulate"
            ) from None
        return Rig(open_camera(serial), NoLights())

    return connect


def camera_plugged_in() -> bool:
    """Whether any camera is on USB; false where USB can't be looked at."""
    try:
        from hueflight.devices.usb import find_cameras

        return bool(find_cameras())
    except (DeviceError, ImportError):
        return False


def simulated(instrument: Instrument, *, scene: str = "fig1", frames: int = 960) -> Connect:
    """How to open a simulated rig; the photons are drawn once and kept between connections."""
    from hueflight.devices.simulated import SimulatedInstrument

    model = SimulatedInstrument(instrument, scene=scene, frames=frames)
    return model.connect
