# SPDX-License-Identifier: Apache-2.0
"""The rigs of boards that are plugged in: a camera on USB, an illuminator on a serial port."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING
from urllib.parse import quote

from hueflight.devices.errors import DeviceError
from hueflight.devices.rig import Connect, RigAddress, RigAddressError, RigPart, rig_from_uri
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

if TYPE_CHECKING:
    from hueflight.devices.camera import Camera
    from hueflight.devices.illuminator_driver import IlluminatorDriver

NOTICE = (
    "no camera is plugged in: using the SIMULATED instrument. Pictures and recordings are marked "
    "so; --no-simulate waits for a camera instead"
)


def usb_camera(address: RigAddress, instrument: Instrument, /) -> RigPart:
    """Return how to open a camera on USB, for the scheme ``usb``.

    Parameters
    ----------
    address : RigAddress
        Its path is the camera's serial number, empty for the only camera there is.
    instrument : Instrument
        Not needed to open a camera.

    Returns
    -------
    RigPart
        Opens a camera.

    Raises
    ------
    RigAddressError
        If the address has an option.
    """
    address.convert_options()
    return RigPart(open_camera=partial(open_usb_camera, address.path))


def open_usb_camera(serial: str, /) -> Camera:
    """Open a camera on USB.

    Parameters
    ----------
    serial : str
        Its serial number, empty for the only camera there is.

    Returns
    -------
    Camera
        The camera.

    Raises
    ------
    DeviceError
        If there is none, or a package is missing.
    """
    try:
        from hueflight.devices.transports.usb import open_camera
    except ImportError as error:
        raise DeviceError(
            f"cameras need the package {error.name}: install hueflight[devices], or use --simulate"
        ) from None
    return open_camera(serial or None)


def serial_illuminator(address: RigAddress, instrument: Instrument, /) -> RigPart:
    """Return how to open an illuminator on a serial port, for the scheme ``serial``.

    Parameters
    ----------
    address : RigAddress
        Its path is the serial port; the option ``baud`` is the line rate in bits per second.
    instrument : Instrument
        Instrument whose LEDs the illuminator drives.

    Returns
    -------
    RigPart
        Opens an illumination.

    Raises
    ------
    RigAddressError
        If the address has no port, or an option is not known.
    """
    if not address.path:
        raise RigAddressError(f"{address.text} names no port: write it as serial:/dev/ttyUSB0")
    options = address.convert_options(baud=int)
    return RigPart(open_illumination=lambda: open_illumination(address.path, instrument, **options))


def open_illumination(
    port: str, instrument: Instrument, /, *, baud: int | None = None
) -> IlluminatorDriver:
    """Open the illuminator on a serial port and load an instrument's schedule, LEDs off.

    Parameters
    ----------
    port : str
        Serial port, such as ``/dev/ttyUSB0``.
    instrument : Instrument
        Instrument whose LEDs it drives.
    baud : int, optional
        Line rate in bits per second; by default it is found by asking the board.

    Returns
    -------
    IlluminatorDriver
        The illumination for captures.

    Raises
    ------
    DeviceError
        If the port can't be opened, no illuminator answers, or it can't drive these LEDs.
    """
    from hueflight.devices.illuminator import open_illuminator
    from hueflight.devices.illuminator_driver import IlluminatorDriver

    board = open_illuminator(port, baud=baud)
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
    """Return whether a camera is on USB.

    Returns
    -------
    bool
        True if at least one is there; False also where USB can't be searched.
    """
    try:
        from hueflight.devices.transports.usb import find_cameras

        return bool(find_cameras())
    except (DeviceError, ImportError):
        return False


def choose_rig(
    instrument: Instrument,
    /,
    *,
    uri: str | None = None,
    simulate: bool | None = None,
    serial: str | None = None,
    illuminator: str | None = None,
    scene: str | None = None,
    say: Callable[[str], None],
) -> Connect:
    """Return how to open the rig that the options of a program ask for.

    Parameters
    ----------
    instrument : Instrument
        The instrument that the rig should be.
    uri : str, optional
        Address of the rig, in place of all other options.
    simulate : bool, optional
        True for the simulated instrument, False for hardware; by default hardware if a camera is
        plugged in or named.
    serial : str, optional
        Serial number of the camera; naming one means hardware.
    illuminator : str, optional
        Serial port of the illuminator; naming one means hardware. By default something else
        drives the LEDs.
    scene : str, optional
        Scene of the simulated instrument.
    say : callable
        Receives a sentence for the user where the simulated instrument was chosen by default.

    Returns
    -------
    callable
        Opens the rig.

    Raises
    ------
    RigAddressError
        If an address is given together with an option that it replaces, or is not one.
    """
    if uri is not None:
        others = {"simulate": simulate, "camera": serial, "illuminator": illuminator}
        given = [f"--{name}" for name, value in others.items() if value is not None]
        if given:
            raise RigAddressError(
                f"--rig {uri} says which camera and illumination to use: leave out "
                f"{', '.join(given)}"
            )
        return rig_from_uri(uri, instrument)
    if simulate is None:
        simulate = serial is None and illuminator is None and not camera_plugged_in()
        if simulate:
            say(NOTICE)
    if simulate:
        return rig_from_uri(f"simulated:{_quoted(scene)}", instrument)
    address = f"usb:{_quoted(serial)}"
    if illuminator:
        address += f"+serial:{_quoted(illuminator)}"
    return rig_from_uri(address, instrument)


def _quoted(text: str | None) -> str:
    return quote(text or "", safe="/")
