"""Bytes in, frames out: a bounded buffer between a live stream and the kernels."""

from __future__ import annotations

import mmap
from collections.abc import Iterator

from hueflight.errors import IngestError
from hueflight.ingest.kernels import Kernels
from hueflight.ingest.scanner import BATCH_FRAMES, Scanner
from hueflight.model.instrument import Sensor
from hueflight_protocol.wire import MAX_PACKET_BYTES

BUFFER_BYTES = 32 << 20
"""Holds a video frame's worth (620) of the paper's sensor at full occupancy, 17 MB, and more."""
LEAST_BYTES = 2 * MAX_PACKET_BYTES  # one packet, and room to receive the next


class PacketBuffer:
    """Takes bytes in pieces of any size, and finds the frames in them.

    The frames stay where they came; whoever counts or stores them does so while they are at
    hand, and then lets go of them with `release`. Memory is the buffer and the scanner's tables,
    however long the stream.

    Parameters
    ----------
    sensor : Sensor
        Frames of other geometry or code width are counted as foreign.
    kernels : Kernels
        Compiled or NumPy.
    capacity : int
        Bytes of the buffer.
    limit : int
        Most frames at hand.

    Attributes
    ----------
    scanner : tables and totals.
    others : packets that are not frames, as received, until somebody takes them away.
    """

    def __init__(
        self,
        sensor: Sensor,
        kernels: Kernels,
        *,
        capacity: int = BUFFER_BYTES,
        limit: int = BATCH_FRAMES,
    ) -> None:
        if capacity < LEAST_BYTES:
            raise IngestError(
                f"a buffer of {capacity} bytes: must be at least {LEAST_BYTES}, twice the longest "
                "packet"
            )
        self.scanner = Scanner(sensor, kernels, limit)
        self.others: list[bytes] = []
        self._octets = mmap.mmap(-1, capacity)  # takes memory only where bytes have been
        self._view = memoryview(self._octets)
        self._filled = 0
        self._scanned = 0
        self._needed = 0  # bytes without which scanning would not get on

    @property
    def data(self) -> memoryview:
        """The bytes that the scanner's tables refer to."""
        return self._view[: self._filled]

    @property
    def complete(self) -> memoryview:
        """The bytes at hand up to where a packet is still incomplete."""
        return self._view[: self._scanned]

    @property
    def pending(self) -> int:
        """Bytes that wait for the rest of their packet."""
        return self._filled - self._scanned

    @property
    def room(self) -> int:
        """Bytes that can be received before frames must be let go of."""
        return len(self._view) - self._filled

    @property
    def tight(self) -> bool:
        """Whether the longest packet might not fit any more behind what is at hand."""
        return self._scanned + LEAST_BYTES > len(self._view)

    def writable(self) -> memoryview:
        """Where the next bytes go: `recv_into` or `readinto` this, then `commit`."""
        return self._view[self._filled :]

    def commit(self, size: int, /) -> None:
        """Say that `size` more bytes have been received."""
        if not 0 <= size <= self.room:
            raise IngestError(f"{size} bytes: must be from 0 to {self.room}, the room there was")
        self._filled += size

    def scan(self, *, limit: int, final: bool = False) -> bool:
        """Look for frames until there are `limit`; return whether more bytes are needed to go on.

        If they are not, there are `limit` frames, or the tables are full and `release` must come
        first.
        """
        scanner = self.scanner
        while True:
            if not final and self._filled - self._scanned < self._needed:
                return True
            found = scanner.scan(self.data, self._scanned, final=final, limit=limit)
            self._scanned, self._needed = found.position, found.needed
            for offset, size in scanner.others[: found.others].tolist():
                self.others.append(bytes(self._view[offset : offset + size]))
            if found.others < len(scanner.others):  # else it stopped to have them taken away
                return found.ended

    def release(self) -> None:
        """Let go of the frames at hand, and move what is left of the bytes to the front."""
        left = self._filled - self._scanned
        self._octets.move(0, self._scanned, left)
        self._filled, self._scanned = left, 0
        self.scanner.clear()


def pieces(buffer: PacketBuffer, data: bytes | bytearray | memoryview, /) -> Iterator[int]:
    """Copy `data` into a buffer, a piece at a time; the caller makes room between them."""
    view = memoryview(data).cast("B") if len(data) else memoryview(b"")
    while view:
        part = view[: buffer.room]
        buffer.writable()[: len(part)] = part
        buffer.commit(len(part))
        view = view[len(part) :]
        yield len(part)
