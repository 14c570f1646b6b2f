# SPDX-License-Identifier: Apache-2.0
"""A rig, which is one camera and its illumination, and the addresses by which rigs are opened.

The address of a rig is a URI, or several that are joined by ``+``::

    rig    = part *( "+" part )
    part   = scheme ":" [ path ] [ "?" option *( "&" option ) ]
    option = name "=" value

Each part brings a camera, an illumination, or both; together they bring exactly one camera and at
most one illumination. Characters that the grammar uses are written percent-encoded in paths and
values; a ``+`` separates parts only where a scheme and a colon follow it.

================================  ==============================================================
``usb:``                          the only camera on USB
``usb:0123ABCD``                  the camera with this serial number
``usb:+serial:/dev/ttyUSB0``      the only camera, and an illuminator on a serial port
``serial:COM3?baud=1000000``      an illuminator whose gateware uses another line rate
``simulated:``                    the simulated instrument, which brings camera and illumination
``simulated:fig1?frames=960``     with a scene of the simulator and a number of distinct frames
================================  ==============================================================

`register_rig` adds a scheme to the running program; a package that is installed adds one through
the entry point group `ENTRY_POINT_GROUP`.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol
from urllib.parse import unquote

from hueflight.devices.camera import Camera
from hueflight.devices.errors import DeviceError
from hueflight.devices.illumination import Illumination, NoIllumination
from hueflight.model.instrument import Instrument

ENTRY_POINT_GROUP = "hueflight.rigs"
"""Entry points of this group are named by a scheme and refer to a `RigOpener`."""

_BUILT_IN = (
    EntryPoint("usb", "hueflight.devices.built_in_rigs:usb_camera", ENTRY_POINT_GROUP),
    EntryPoint("serial", "hueflight.devices.built_in_rigs:serial_illuminator", ENTRY_POINT_GROUP),
    EntryPoint("simulated", "hueflight.emulation.simulated_rig:open_part", ENTRY_POINT_GROUP),
)
_SCHEME = r"[a-z][a-z0-9.-]*"
_PART = re.compile(rf"(?P<scheme>{_SCHEME}):(?P<path>[^?]*)(?:\?(?P<options>.*))?", re.DOTALL)
_BETWEEN_PARTS = re.compile(rf"\+(?={_SCHEME}:)")


class RigAddressError(DeviceError):
    """The address of a rig is malformed, has an unknown scheme, or does not describe a rig."""


@dataclass(frozen=True)
class Rig:
    """One camera and the illumination that belongs to it.

    Attributes
    ----------
    camera : Camera
        The camera, opened.
    illumination : Illumination
        What drives the LEDs, opened.
    """

    camera: Camera
    illumination: Illumination

    @property
    def simulated(self) -> bool:
        """True if the camera's photons are simulated."""
        return self.camera.simulated

    def close(self) -> None:
        """Turn the LEDs off and release the ports."""
        with contextlib.suppress(DeviceError):  # if it is gone, its watchdog turns the LEDs off
            self.illumination.close()
        self.camera.close()


Connect = Callable[[], Rig]
"""Opens a rig; raises `DeviceError` while there is none."""


@dataclass(frozen=True)
class RigAddress:
    """One part of a rig's address, taken apart.

    Attributes
    ----------
    text : str
        The part as it was written, for error messages.
    scheme : str
        Name under which the opener is registered.
    path : str
        Text between the colon and the question mark, decoded; may be empty.
    options : Mapping of str to str
        Options by name, decoded.
    """

    text: str
    scheme: str
    path: str = ""
    options: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str, /) -> RigAddress:
        """Take one part of a rig's address apart.

        Parameters
        ----------
        text : str
            The part, such as ``"simulated:fig1?frames=960"``.

        Returns
        -------
        RigAddress
            Scheme, path and options.

        Raises
        ------
        RigAddressError
            If there is no scheme, or an option is malformed or given twice.
        """
        found = _PART.fullmatch(text)
        if found is None:
            raise RigAddressError(
                f"{text!r} is not the address of a rig: write a scheme and a colon first, such as "
                f"usb: or simulated:fig1; the schemes are {', '.join(rig_schemes())}"
            )
        options: dict[str, str] = {}
        for option in filter(None, (found["options"] or "").split("&")):
            name, equals, value = option.partition("=")
            if not name or not equals:
                raise RigAddressError(f"{text}: option {option!r} must be written name=value")
            if name in options:
                raise RigAddressError(f"{text}: option {name!r} is given twice")
            options[name] = unquote(value)
        return cls(text, found["scheme"], unquote(found["path"]), options)

    def convert_options(self, **types: Callable[[str], Any]) -> dict[str, Any]:
        """Convert the options that are given.

        Parameters
        ----------
        **types : callable
            Conversion from text for every option that the scheme knows.

        Returns
        -------
        dict
            Values by name, of the options that the address has.

        Raises
        ------
        RigAddressError
            If an option is not known, or its value can't be converted.
        """
        values: dict[str, Any] = {}
        for name, text in self.options.items():
            if name not in types:
                known = ", ".join(types) or "none"
                raise RigAddressError(
                    f"{self.text}: {self.scheme}: has no option {name!r}; its options: {known}"
                )
            try:
                values[name] = types[name](text)
            except ValueError:
                raise RigAddressError(
                    f"{self.text}: {name} = {text!r} is not of type {types[name].__name__}"
                ) from None
        return values


@dataclass(frozen=True)
class RigPart:
    """How to open what one part of an address stands for.

    Attributes
    ----------
    open_camera : callable, optional
        Opens the camera; raises `DeviceError` while there is none.
    open_illumination : callable, optional
        Opens the illumination, LEDs off; raises `DeviceError` while there is none.
    """

    open_camera: Callable[[], Camera] | None = None
    open_illumination: Callable[[], Illumination] | None = None


class RigOpener(Protocol):
    """Function behind a scheme."""

    def __call__(self, address: RigAddress, instrument: Instrument, /) -> RigPart:
        """Check an address and return how to open what it stands for.

        Parameters
        ----------
        address : RigAddress
            The part of the rig's address that has this scheme.
        instrument : Instrument
            The instrument that the rig should be.

        Returns
        -------
        RigPart
            Functions that open it. They are called again and again while a device is missing.

        Raises
        ------
        DeviceError
            If the address or the instrument does not suit this scheme.
        """
        ...


_registered: dict[str, RigOpener] = {}


def register_rig(scheme: str, opener: RigOpener, /) -> None:
    """Make a scheme known to this program.

    Parameters
    ----------
    scheme : str
        Lower-case letters, digits, periods and hyphens, beginning with a letter.
    opener : RigOpener
        Function that returns how to open an address with this scheme.

    Raises
    ------
    RigAddressError
        If the scheme is malformed or taken.
    """
    if not re.fullmatch(_SCHEME, scheme):
        raise RigAddressError(
            f"scheme {scheme!r}: must be lower-case letters, digits, '.' and '-', letter first"
        )
    if scheme in rig_schemes():
        raise RigAddressError(f"scheme {scheme!r} is already taken; choose another name")
    _registered[scheme] = opener


def rig_schemes() -> tuple[str, ...]:
    """Return every known scheme.

    Returns
    -------
    tuple of str
        Schemes that are built in, registered, or brought by installed packages.
    """
    installed = sorted(entry_points(group=ENTRY_POINT_GROUP).names)
    return tuple(dict.fromkeys([*(built.name for built in _BUILT_IN), *_registered, *installed]))


def rig_from_uri(uri: str, instrument: Instrument, /) -> Connect:
    """Return how to open the rig at an address.

    Parameters
    ----------
    uri : str
        Address in the grammar of this module, such as ``"usb:+serial:/dev/ttyUSB0"``.
    instrument : Instrument
        The instrument that the rig should be.

    Returns
    -------
    callable
        Opens the rig; to be called again after the rig was lost.

    Raises
    ------
    RigAddressError
        If the address is malformed, a scheme is not known, or the parts do not bring exactly one
        camera and at most one illumination.
    DeviceError
        If a part of it does not suit the instrument.
    """
    parts: list[tuple[str, RigPart]] = []
    for text in _BETWEEN_PARTS.split(uri):
        address = RigAddress.parse(text)
        parts.append((text, _opener(address)(address, instrument)))
    cameras = [(text, part.open_camera) for text, part in parts if part.open_camera]
    drivers = [(text, part.open_illumination) for text, part in parts if part.open_illumination]
    if not cameras:
        raise RigAddressError(
            f"{uri} names no camera: put one in front, such as usb:+{uri} for the camera on USB"
        )
    for what, found in (("cameras", cameras), ("illuminations", drivers)):
        if len(found) > 1:
            named = " and ".join(text for text, _ in found)
            raise RigAddressError(
                f"{uri} names {len(found)} {what}, {named}: leave one of them out"
            )
    open_camera = cameras[0][1]
    open_illumination = drivers[0][1] if drivers else NoIllumination

    def connect() -> Rig:
        camera = open_camera()
        try:
            return Rig(camera, open_illumination())
        except BaseException:
            camera.close()
            raise

    return connect


def _opener(address: RigAddress) -> RigOpener:
    scheme = address.scheme
    if scheme in _registered:
        return _registered[scheme]
    for entry in (*_BUILT_IN, *entry_points(group=ENTRY_POINT_GROUP)):
        if entry.name == scheme:
            try:
                return entry.load()
            except (ImportError, AttributeError) as error:
                raise RigAddressError(
                    f"{address.text}: scheme {scheme!r} can't be loaded from {entry.value}: {error}"
                ) from error
    raise RigAddressError(
        f"{address.text}: there is no scheme {scheme!r}; the schemes are {', '.join(rig_schemes())}"
    )
