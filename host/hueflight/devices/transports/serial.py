# SPDX-License-Identifier: Apache-2.0
"""Control messages on a serial line: COBS frames over whatever carries bytes."""

from __future__ import annotations

import time
from typing import Protocol

from hueflight.devices.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceGoneError,
    DeviceNotFoundError,
    DevicePermissionError,
)
from hueflight_protocol import CobsDecoder, serial_frame
from hueflight_protocol.control import MAX_COBS_BYTES

BAUD = 3_000_000
"""What the gateware is built for, unless it was built for something else."""
_MOST_BYTES = 4096


class ByteLine(Protocol):
    """Bytes to and from a board: a serial port, a pseudo terminal, a simulated pin.

    Attributes
    ----------
    name : str
        Place of the board for people.
    """

    name: str

    def write(self, data: bytes, /) -> None:
        """Send all bytes; raises `DeviceGoneError` if nobody is there."""
        ...

    def read(self, timeout_s: float, /) -> bytes:
        """Return what has come.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait for the first byte, in seconds.

        Returns
        -------
        bytes
            The bytes, empty if none came in time.
        """
        ...

    def close(self) -> None:
        """Release the line; closing twice is harmless."""
        ...


class SerialTransport:
    """Carries control messages over a line of bytes.

    Every frame is preceded by a delimiter, so that noise since the last one spoils nothing.

    Parameters
    ----------
    line : ByteLine
        Line to send and receive on.
    """

    def __init__(self, line: ByteLine, /) -> None:
        self.name = line.name
        self._line = line
        self._decoder = CobsDecoder(limit=MAX_COBS_BYTES)
        self._messages: list[bytes] = []

    def send(self, message: bytes, /) -> None:
        """Send one encoded request."""
        self._line.write(b"\0" + serial_frame(message))

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Return the next whole message.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.

        Returns
        -------
        bytes or None
            The message, None if none came in time.
        """
        deadline = time.monotonic() + timeout_s
        while not self._messages:
            left = deadline - time.monotonic()
            if left <= 0:
                return None
            self._messages += self._decoder.feed(self._line.read(left))
        return self._messages.pop(0)

    def close(self) -> None:
        """Release the line."""
        self._line.close()


class SerialPort:
    """A serial port of the computer, through pyserial.

    Parameters
    ----------
    path : str
        Serial port, such as ``/dev/ttyUSB0``.
    baud : int
        Line rate in bits per second; must be the gateware's.

    Raises
    ------
    DeviceNotFoundError, DevicePermissionError, DeviceBusyError
        If the port is not there, may not be opened, or is held by another program.
    """

    def __init__(self, path: str, /, *, baud: int = BAUD) -> None:
        try:
            import serial
        except ImportError:
            raise DeviceError(
                "serial ports need the package pyserial: install hueflight[devices]"
            ) from None
        self.name = path
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=1.0, exclusive=True)
        except OSError as error:  # SerialException is one
            raise _explain(path, error) from error

    def write(self, data: bytes, /) -> None:
        """Send all bytes."""
        try:
            self._port.write(data)
        except OSError as error:
            raise self._gone(error) from error

    def read(self, timeout_s: float, /) -> bytes:
        """Return what has come.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait for the first byte, in seconds.

        Returns
        -------
        bytes
            The bytes, empty if none came in time.
        """
        try:
            self._port.timeout = timeout_s
            first = self._port.read(1)
            return first + self._port.read(min(self._port.in_waiting, _MOST_BYTES))
        except OSError as error:  # pyserial raises a bare one when the adapter is unplugged
            raise self._gone(error) from error

    def close(self) -> None:
        """Release the port."""
        self._port.close()

    def _gone(self, error: OSError) -> DeviceGoneError:
        return DeviceGoneError(
            f"{self.name} went away ({error}): was the illuminator unplugged or switched off?"
        )


def _explain(path: str, error: OSError) -> DeviceError:
    text = str(error)
    if error.errno == 2 or "No such file" in text:
        return DeviceNotFoundError(
            f"there is no serial port {path}: is the illuminator plugged in?"
        )
    if error.errno == 13 or "Permission denied" in text:
        return DevicePermissionError(
            f"this user may not open {path}: install the udev rule, or join the group that owns it"
        )
    if error.errno in (11, 16) or "exclusively lock" in text or "busy" in text:
        return DeviceBusyError(f"another program holds {path}: close it first")
    return DeviceError(f"{path} can't be opened: {text}")
