"""The seam of the packet stream: pieces of bytes in order, and what became of the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class StreamStatistics:
    """What a stream has carried since it was opened.

    Attributes
    ----------
    received_bytes : delivered by the link.
    queued_bytes, queue_limit_bytes : received and not yet read, and the most there may be.
    stalls, stalled_s : how often and how long the reader was so late that the host asked the
        camera for nothing; what the camera drops meanwhile is the host's loss.
    link_errors : stalls, overflows and failed transfers of the link; the parser finds what of
        the stream they cost.
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
        """Return the next piece, or ``b""`` if none came in time.

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
        """Stop asking and give the link back; closing twice is harmless."""
        ...
