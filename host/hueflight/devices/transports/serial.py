# SPDX-License-Identifier: Apache-2.0
"""Control messages on a serial line: COBS frames over whatever carries bytes."""

from __future__ import annotations

import contextlib
import time
from typing import Protocol

from hueflight.devices.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceGoneError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceTimeoutError,
)
from hueflight_protocol import (
    CobsDecoder,
    MessageError,
    decode_response,
    encode_request,
    serial_frame,
)
from hueflight_protocol.control import MAX_COBS_BYTES, identify

BAUD = 3_000_000
"""What the gateware is built for, unless it was built for something else."""
RATES = (BAUD, 1_000_000, 2_000_000, 921_600, 500_000, 460_800, 230_400, 115_200, 57_600, 9_600)
"""Line rates at which `find_baud` asks, in bits per second."""
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
    DeviceError
        If the port can't have that rate.
    """

    def __init__(self, path: str, /, *, baud: int = BAUD) -> None:
        try:
            import serial
        except ImportError:
            raise DeviceError(
                "serial ports need the package pyserial: install hueflight[devices]"
            ) from None
        self.name = path
        if baud < 1:
            raise DeviceError(f"{path} can't be set to {baud} baud: must be 1 or more")
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=1.0, exclusive=True)
        except OSError as error:  # SerialException is one
            raise _explain(path, error) from error
        except ValueError as error:
            raise DeviceError(f"{path} can't be set to {baud} baud: {error}") from error

    def set_baud(self, baud: int, /) -> None:
        """Change the line rate, in bits per second; what has come and was not read is lost."""
        try:
            self._port.baudrate = baud
            self._port.reset_input_buffer()
        except (OSError, ValueError) as error:  # adapters refuse rates that they can't make
            raise DeviceError(f"{self.name} can't be set to {baud} baud: {error}") from error

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


def find_baud(port: SerialPort, /, *, timeout_s: float = 0.2) -> int:
    """Find the line rate of a board by asking it what it is at one rate after another.

    Parameters
    ----------
    port : SerialPort
        The port; it is left at the rate that was found.
    timeout_s : float
        Longest time to wait for an answer at each rate, in seconds.

    Returns
    -------
    int
        The rate in bits per second.

    Raises
    ------
    DeviceTimeoutError
        If no board answers at any of `RATES`.
    """
    for number, baud in enumerate(RATES, start=1):
        try:
            port.set_baud(baud)
        except DeviceError:  # another rate may work; if the port is gone, sending says so
            continue
        transport = SerialTransport(port)
        transport.send(encode_request(identify(number)))
        deadline = time.monotonic() + timeout_s
        while (answer := transport.receive(deadline - time.monotonic())) is not None:
            with contextlib.suppress(MessageError):
                # an answer to an earlier request came at another rate
                if decode_response(answer).transaction == number:
                    return baud
    tried = ", ".join(map(str, RATES))
    raise DeviceTimeoutError(
        f"no board answers on {port.name} at {tried} baud: is the illuminator switched on, and is "
        "this its port? Give the rate of a build that has another one"
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
