# SPDX-License-Identifier: Apache-2.0
"""Registers that both boards have as types; written by `tools/typed_registers.py`, not by hand."""

from dataclasses import dataclass
from typing import ClassVar

from ..register_value import RegisterValue

__all__ = [
    "Board",
    "ClockHz",
    "ClockSource",
    "ClockState",
    "Map",
    "ReferenceHz",
    "RequestErrors",
    "Requests",
    "Scratch",
    "Serial",
    "Source",
    "Temperature",
    "Uptime",
    "Versions",
]


@dataclass(frozen=True, slots=True)
class Board(RegisterValue):
    """Kind of board: `HCAM`, the camera, or `HILL`, the illuminator.

    Attributes
    ----------
    value : int
        ASCII letters, the first in the lowest byte.
    """

    NAME: ClassVar[str] = "board"
    ADDRESS: ClassVar[int] = 0x0000
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Versions(RegisterValue):
    """Versions of protocol and gateware.

    Attributes
    ----------
    protocol : int
        Version of the control protocol.
    patch : int
        Patch version of the gateware.
    minor : int
        Minor version of the gateware.
    major : int
        Major version of the gateware.
    """

    NAME: ClassVar[str] = "versions"
    ADDRESS: ClassVar[int] = 0x0001
    PROTOCOL_MAX: ClassVar[int] = 255
    PATCH_MAX: ClassVar[int] = 255
    MINOR_MAX: ClassVar[int] = 255
    MAJOR_MAX: ClassVar[int] = 255

    protocol: int = 1
    patch: int = 0
    minor: int = 0
    major: int = 0


@dataclass(frozen=True, slots=True)
class Map(RegisterValue):
    """Fingerprint of the register map.

    Attributes
    ----------
    value : int
        CRC-32C of the map.
    """

    NAME: ClassVar[str] = "map"
    ADDRESS: ClassVar[int] = 0x0002
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Serial(RegisterValue):
    """Serial number of the board.

    Attributes
    ----------
    value : int
        Serial number.
    """

    NAME: ClassVar[str] = "serial"
    ADDRESS: ClassVar[int] = 0x0003
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class ClockHz(RegisterValue):
    """Device clock.

    Attributes
    ----------
    value : int
        Value, in Hz.
    """

    NAME: ClassVar[str] = "clock_hz"
    ADDRESS: ClassVar[int] = 0x0005
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Source(RegisterValue):
    """First 32 bits of the source's hash.

    Attributes
    ----------
    value : int
        Start of the hash.
    """

    NAME: ClassVar[str] = "source"
    ADDRESS: ClassVar[int] = 0x0006
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Uptime(RegisterValue):
    """Clocks since reset.

    Attributes
    ----------
    value : int
        Value, in clock.
    """

    NAME: ClassVar[str] = "uptime"
    ADDRESS: ClassVar[int] = 0x000A
    VALUE_MAX: ClassVar[int] = 18446744073709551615

    value: int


@dataclass(frozen=True, slots=True)
class Requests(RegisterValue):
    """Requests answered, saturating.

    Attributes
    ----------
    value : int
        Number of requests.
    """

    NAME: ClassVar[str] = "requests"
    ADDRESS: ClassVar[int] = 0x000C
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestErrors(RegisterValue):
    """Messages dropped.

    Attributes
    ----------
    crc : int
        Messages whose CRC was wrong, saturating.
    framing : int
        Messages of impossible length or broken COBS, saturating.
    """

    NAME: ClassVar[str] = "request_errors"
    ADDRESS: ClassVar[int] = 0x000D
    CRC_MAX: ClassVar[int] = 65535
    FRAMING_MAX: ClassVar[int] = 65535

    crc: int = 0
    framing: int = 0


@dataclass(frozen=True, slots=True)
class Temperature(RegisterValue):
    """Temperature.

    Attributes
    ----------
    value : int
        Temperature of the FPGA; -2^31 = not measured, in m°C.
    """

    NAME: ClassVar[str] = "temperature"
    ADDRESS: ClassVar[int] = 0x000E
    VALUE_MAX: ClassVar[int] = 2147483647
    VALUE_MIN: ClassVar[int] = -2147483648

    value: int


@dataclass(frozen=True, slots=True)
class Scratch(RegisterValue):
    """For trying the link.

    Attributes
    ----------
    value : int
        Any number.
    """

    NAME: ClassVar[str] = "scratch"
    ADDRESS: ClassVar[int] = 0x000F
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockState(RegisterValue):
    """Clock in use, in builds with an external clock.

    Attributes
    ----------
    external : int
        The external clock is in use.
    present : int
        There is an external clock of the right frequency.
    lost : int
        It was lost while in use; until it is asked for again.
    """

    NAME: ClassVar[str] = "clock_state"
    ADDRESS: ClassVar[int] = 0x0013
    EXTERNAL_MAX: ClassVar[int] = 1
    PRESENT_MAX: ClassVar[int] = 1
    LOST_MAX: ClassVar[int] = 1

    external: int = 0
    present: int = 0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class ReferenceHz(RegisterValue):
    """Frequency that the external clock must have, in builds with one.

    Attributes
    ----------
    value : int
        Value, in Hz.
    """

    NAME: ClassVar[str] = "reference_hz"
    ADDRESS: ClassVar[int] = 0x0014
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class ClockSource(RegisterValue):
    """Clock that is wanted, in builds with an external one.

    A change disarms an illuminator and ends the capture of a camera.

    Attributes
    ----------
    external : int
        Run from the external clock; asks anew when it becomes 1.
    """

    NAME: ClassVar[str] = "clock_source"
    ADDRESS: ClassVar[int] = 0x0016
    EXTERNAL_MAX: ClassVar[int] = 1

    external: int
