# SPDX-License-Identifier: Apache-2.0
"""Interface of the packet stream: pieces of bytes in order, and the link's statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class StreamStatistics:
    """What a stream has carried since it was opened.

    Attributes
    ----------
    received_bytes : int
        Number of bytes that the link delivered.
    queued_bytes, queue_limit_bytes : int
        Number of bytes received and not yet read, and the most there may be.
    stalls : int
        How many times the reader was so late that the host asked the camera for no data. What
        the camera drops meanwhile is a loss of the host.
    stalled_s : float
        Total duration of the stalls, in seconds.
    link_errors : int
        Number of halts, overflows and failed transfers of the link; the parser finds what of the
        stream they cost.
    """

    received_bytes: int = 0
    queued_bytes: int = 0
    queue_limit_bytes: int = 0
    stalls: int = 0
    stalled_s: float = 0.0
    link_errors: int = 0


class Stream(Protocol):
    """Bytes of the packet stream, in order and in pieces of any size."""

    def read(self, timeout_s: float, /) -> bytes:
        """Return the next piece.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.

        Returns
        -------
        bytes
            The piece, empty if none came in time.

        Raises
        ------
        DeviceGoneError
            If the camera is no longer there and all that came before has been read.
        """
        ...

    @property
    def statistics(self) -> StreamStatistics:
        """Totals so far."""
        ...

    def close(self) -> None:
        """Stop asking for data and release the link; closing twice is harmless."""
        ...
