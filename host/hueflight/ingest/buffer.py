# SPDX-License-Identifier: Apache-2.0
"""A bounded buffer between a live stream of bytes and the kernels."""

from __future__ import annotations

import mmap
from collections.abc import Iterator

from hueflight.errors import IngestError
from hueflight.ingest.kernels import Kernels
from hueflight.ingest.scanner import BATCH_FRAMES, Scanner
from hueflight.model.instrument import Sensor
from hueflight_protocol.wire import MAX_PACKET_BYTES

BUFFER_BYTES = 32 << 20
"""Enough for 620 frames (1/30 s) of the paper's sensor at full occupancy, which are 17 MB."""
LEAST_BYTES = 2 * MAX_PACKET_BYTES  # one packet, and room to receive the next


class PacketBuffer:
    """Receives bytes in pieces of any size and finds the frames in them.

    Frames are not copied: they are counted or stored from the buffer, and then given up with
    `release`. Memory use is that of the buffer and of the tables of the scanner, and does not
    depend on the length of the stream.

    Parameters
    ----------
    sensor : Sensor
        Sensor whose frames are wanted; frames of another geometry or code width are counted as
        foreign.
    kernels : Kernels
        Backend that scans.
    capacity : int
        Size of the buffer in bytes.
    limit : int
        Largest number of frames that are held at a time.

    Attributes
    ----------
    scanner : Scanner
        Tables of the frames in the buffer, and totals.
    others : list of bytes
        Packets received so far that are not frames.
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
        self._octets = mmap.mmap(-1, capacity)  # memory is allocated only where bytes are written
        self._view = memoryview(self._octets)
        self._filled = 0
        self._scanned = 0
        self._needed = 0  # bytes needed to make progress

    @property
    def data(self) -> memoryview:
        """The bytes that the tables of the scanner refer to."""
        return self._view[: self._filled]

    @property
    def complete(self) -> memoryview:
        """The received bytes, without the packet at their end that is still incomplete."""
        return self._view[: self._scanned]

    @property
    def pending(self) -> int:
        """Number of bytes of the packet that is still incomplete."""
        return self._filled - self._scanned

    @property
    def room(self) -> int:
        """Number of bytes that can be received before frames must be released."""
        return len(self._view) - self._filled

    @property
    def tight(self) -> bool:
        """Whether the remaining room may be too small for the longest packet."""
        return self._scanned + LEAST_BYTES > len(self._view)

    def writable(self) -> memoryview:
        """Return the memory for the next bytes: `recv_into` or `readinto` it, then `commit`."""
        return self._view[self._filled :]

    def commit(self, size: int, /) -> None:
        """Record that `size` more bytes have been received."""
        if not 0 <= size <= self.room:
            raise IngestError(f"{size} bytes: must be from 0 to {self.room}, the room there was")
        self._filled += size

    def scan(self, *, limit: int, final: bool = False) -> bool:
        """Scan until there are `limit` frames; return whether more bytes are needed to continue.

        If not, there are `limit` frames, or the tables are full and `release` must be called
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
            if found.others < len(
                scanner.others
            ):  # otherwise scanning stopped because `others` was full
                return found.ended

    def release(self) -> None:
        """Give up the frames in the buffer and move the remaining bytes to the front."""
        left = self._filled - self._scanned
        self._octets.move(0, self._scanned, left)
        self._filled, self._scanned = left, 0
        self.scanner.clear()


def pieces(buffer: PacketBuffer, /, *data: bytes | bytearray | memoryview) -> Iterator[int]:
    """Copy bytes into a buffer; the caller makes room whenever it is full, and looks at the end.

    Parameters
    ----------
    buffer : PacketBuffer
        Buffer that receives them.
    *data : bytes-like
        Consecutive parts of the stream.

    Yields
    ------
    int
        Number of bytes that were copied since the last time.
    """
    copied = 0
    for piece in data:
        view = memoryview(piece).cast("B") if len(piece) else memoryview(b"")
        while view:
            part = view[: buffer.room]
            buffer.writable()[: len(part)] = part
            buffer.commit(len(part))
            copied += len(part)
            view = view[len(part) :]
            if not buffer.room:
                yield copied
                copied = 0
    if copied:
        yield copied
