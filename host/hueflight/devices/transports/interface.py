"""The seam below the control protocol: whatever carries whole messages to a board and back."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """Carries control messages, each whole or not at all; knows nothing of what they say.

    `name` is how people know the place: ``/dev/ttyUSB0``, ``USB 1-4``, ``simulated``.
    """

    name: str

    def send(self, message: bytes, /) -> None:
        """Send one encoded request.

        Raises
        ------
        DeviceGoneError
            If the board is no longer there.
        """
        ...

    def receive(self, timeout_s: float, /) -> bytes | None:
        """Return the next whole message, or None if none came in time.

        Raises
        ------
        DeviceGoneError
            If the board is no longer there.
        """
        ...

    def close(self) -> None:
        """Give the line back; closing twice is harmless."""
        ...
