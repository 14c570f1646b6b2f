# SPDX-License-Identifier: Apache-2.0
"""Transactions with a board, recorded as JSON lines, and played again without it.

Each line is an object with one name: ``sent`` or ``received``, and the message in hexadecimal
digits, or null for an answer that did not come in time.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TextIO

from hueflight.devices.errors import DeviceError, DeviceGoneError
from hueflight.devices.transports.interface import Transport


class RecordingTransport:
    """Passes messages on to another transport and records them.

    Parameters
    ----------
    transport : Transport
        Carries the messages.
    path : Path
        File to write; one that exists is replaced.
    """

    def __init__(self, transport: Transport, path: Path, /) -> None:
        self.name = transport.name
        self._transport = transport
        self._file: TextIO = path.open("w", encoding="utf-8")

    def send(self, message: bytes, /) -> None:
        """Send one encoded request."""
        self._file.write(json.dumps({"sent": message.hex()}) + "\n")
        self._transport.send(message)

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Return the next whole message, None if none came in time.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.
        """
        message = self._transport.receive(timeout_s)
        self._file.write(json.dumps({"received": message and message.hex()}) + "\n")
        return message

    def close(self) -> None:
        """Release the line and complete the file."""
        self._file.close()
        self._transport.close()


class ReplayTransport:
    """Answers as a board did when its transactions were recorded.

    Parameters
    ----------
    path : Path
        What `RecordingTransport` wrote.

    Raises
    ------
    DeviceError
        If the file can't be read.
    """

    def __init__(self, path: Path, /) -> None:
        self.name = str(path)
        try:
            lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
            self._steps = [
                (kind, None if text is None else bytes.fromhex(text))
                for line in lines
                for kind, text in line.items()
            ]
        except (OSError, ValueError, AttributeError, TypeError) as error:
            raise DeviceError(f"{path}: can't be read as recorded transactions: {error}") from error
        self._place = 0

    def send(self, message: bytes, /) -> None:
        """Compare a request with the one that was recorded.

        Raises
        ------
        DeviceGoneError
            If another one, or none, was recorded in this place.
        """
        expected = self._next("sent")
        if expected != message:
            raise DeviceGoneError(
                f"{self.name}, line {self._place}: {message.hex()} is sent, but "
                f"{expected.hex() if expected else None} was recorded"
            )

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Return the message that was recorded in this place.

        Parameters
        ----------
        timeout_s : float
            Of no effect; nothing is waited for.
        """
        return self._next("received")

    def close(self) -> None:
        """Do nothing; there is no line."""

    def _next(self, kind: str) -> bytes | None:
        if self._place == len(self._steps) or self._steps[self._place][0] != kind:
            raise DeviceGoneError(
                f"{self.name}, line {self._place + 1}: no message that was {kind} was recorded here"
            )
        self._place += 1
        return self._steps[self._place - 1][1]
