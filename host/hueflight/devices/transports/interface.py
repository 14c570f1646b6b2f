# SPDX-License-Identifier: Apache-2.0
"""Interface below the control protocol: what carries whole messages to a board and back."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """Carries control messages, each whole or not at all.

    Attributes
    ----------
    name : str
        Place of the board for people, such as ``/dev/ttyUSB0``, ``USB 001:004``, ``simulated``.
    """

    name: str

    def send(self, message: bytes, /) -> None:
        """Send one encoded request.

        Parameters
        ----------
        message : bytes
            The request.

        Raises
        ------
        DeviceGoneError
            If the board is no longer there.
        """
        ...

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

        Raises
        ------
        DeviceGoneError
            If the board is no longer there.
        """
        ...

    def close(self) -> None:
        """Release the line; closing twice is harmless."""
        ...
