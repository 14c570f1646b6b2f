"""A rig: one camera and its lights, found on the ports or simulated."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import Illumination, NoIllumination
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

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
    lights: Illumination

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


def hardware(
    serial: str | None = None,
    *,
    illuminator: str | None = None,
    instrument: Instrument | None = None,
) -> Connect:
    """How to open the boards that are plugged in.

    Parameters
    ----------
    serial : number of the camera, None for the only one.
    illuminator : serial port of the illuminator, None if something else drives the LEDs.
    instrument : whose LEDs it drives; needed with one.

    Raises
    ------
    DeviceError
        If an illuminator is named without an instrument.
    """
    if illuminator and instrument is None:
        raise DeviceError(f"illuminator {illuminator}: say which instrument's LEDs it drives")

    def connect() -> Rig:
        try:
            from hueflight.devices.transports.usb import open_camera
        except ImportError as error:
            raise DeviceError(
                f"cameras need the package {error.name}: install hueflight[devices], or use "
                "--simulate"
            ) from None
        camera = open_camera(serial)
        if not illuminator or instrument is None:
            return Rig(camera, NoIllumination())
        try:
            return Rig(camera, lights_on(illuminator, instrument))
        except DeviceError:
            camera.close()
            raise

    return connect


def lights_on(port: str, instrument: Instrument, /) -> Illumination:
    """The illuminator on a serial port, loaded with an instrument's schedule, LEDs dark.

    Raises
    ------
    DeviceError
        If the port can't be opened, no illuminator answers, or it can't drive these LEDs.
    """
    from hueflight.devices.illuminator import open_illuminator
    from hueflight.devices.illuminator_driver import IlluminatorDriver

    board = open_illuminator(port)
    try:
        return IlluminatorDriver(board, instrument)
    except HueflightError as error:
        with contextlib.suppress(DeviceError):  # the first error says more
            board.close()
        if isinstance(error, DeviceError):
            raise
        raise DeviceError(
            f"the illuminator on {port} can't drive the LEDs of {instrument.name!r}: {error}"
        ) from error


def camera_plugged_in() -> bool:
    """Whether any camera is on USB; false where USB can't be looked at."""
    try:
        from hueflight.devices.transports.usb import find_cameras

        return bool(find_cameras())
    except (DeviceError, ImportError):
        return False


def simulated(instrument: Instrument, *, scene: str = "fig1", frames: int = 960) -> Connect:
    """How to open a simulated rig; the photons are drawn once and kept between connections."""
    from hueflight.emulation.simulated_rig import SimulatedInstrument

    model = SimulatedInstrument(instrument, scene=scene, frames=frames)
    return model.connect
