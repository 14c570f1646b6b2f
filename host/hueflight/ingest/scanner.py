"""Scanning pieces of a stream: the tables that the kernels fill, and what is carried on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import IngestError
from hueflight.ingest.kernels import STATE, Buffer, Kernels, Scanned
from hueflight.model.instrument import Sensor
from hueflight_protocol.wire import DEFAULT_RUN, FRAME_HEADER, MAX_CHUNKS

BATCH_FRAMES = 1024  # frames counted together: few enough that their packets stay in the cache
WINDOW_BYTES = 1 << 30  # scanned at a time; places in the tables are 32-bit
OTHERS = 64
CARRIED = ("in_step", "has_sequence", "sequence", "has_dropped", "capture", "last_dropped")


@dataclass(slots=True)
class Scanner:
    """Finds the frames of one sensor in a stream that comes in pieces.

    Parameters
    ----------
    sensor : Sensor
        Frames of other geometry or code width are counted as foreign.
    kernels : Kernels
        Compiled or NumPy.
    limit : int
        Most frames at a time.

    Attributes
    ----------
    state : int64 array, named by `kernels.STATE`.
    chunks, headers, places : tables of the frames at hand; see `numpy_scan.scan`.
    frames, run, stride : how many frames, their run length, and the stride of `chunks`.
    """

    sensor: Sensor
    kernels: Kernels
    limit: int = BATCH_FRAMES
    state: NDArray[np.int64] = field(init=False)
    chunks: NDArray[np.uint64] = field(init=False)
    headers: NDArray[np.uint8] = field(init=False)
    places: NDArray[np.uint64] = field(init=False)
    others: NDArray[np.uint64] = field(init=False)
    frames: int = field(init=False, default=0)
    run: int = field(init=False, default=0)
    stride: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        chunks = -(-self.sensor.rows * self.sensor.cols // DEFAULT_RUN)
        self.state = np.zeros(len(STATE), np.int64)
        self.state[STATE.index("in_step")] = 1
        # Other run lengths than the usual one make do with fewer frames at a time. A row is a cache
        # line longer than the frames: at a power of two a frame's entries collide in the cache.
        self.chunks = np.zeros(max(MAX_CHUNKS, chunks * (self.limit + 8)), np.uint64)
        self.headers = np.zeros((self.limit, FRAME_HEADER.size), np.uint8)
        self.places = np.zeros((self.limit, 2), np.uint64)
        self.others = np.zeros((OTHERS, 2), np.uint64)

    def scan(self, data: Buffer, start: int, *, final: bool, limit: int | None = None) -> Scanned:
        """Go on from byte `start`, adding frames to the tables until there are `limit`."""
        found = Scanned(
            *self.kernels.scan(
                data,
                start,
                final,
                self.sensor.rows,
                self.sensor.cols,
                self.sensor.code_bits,
                self.frames,
                min(limit or self.limit, self.limit),
                self.run if self.frames else 0,
                self.state,
                self.chunks,
                self.headers,
                self.places,
                self.others,
            )
        )
        self.frames, self.run, self.stride = found.frames, found.run, found.stride
        return found

    def clear(self) -> None:
        """Forget the frames at hand, not the totals."""
        self.frames = 0

    def reset_totals(self) -> None:
        """Start the totals anew; what is carried from packet to packet stays."""
        for number, name in enumerate(STATE):
            if name not in CARRIED:
                self.state[number] = 0

    def header_fields(self) -> NDArray[np.void]:
        """Headers of the frames at hand, as a structured array (frame,)."""
        return self.headers[: self.frames].reshape(-1).view(FRAME_HEADER.dtype)

    def total(self, name: str) -> int:
        """One of the totals in `state`."""
        return int(self.state[STATE.index(name)])

    def refuse_foreign(self) -> None:
        """Complain about frames that are not this sensor's, if there were any.

        Raises
        ------
        IngestError
            With both geometries.
        """
        if not self.total("foreign"):
            return
        sensor = self.sensor
        raise IngestError(
            f"{self.total('foreign')} frames of {self.total('foreign_rows')} × "
            f"{self.total('foreign_cols')} pixels and {self.total('foreign_bits')}-bit codes among "
            f"the packets, but the instrument has {sensor.rows} × {sensor.cols} pixels and "
            f"{sensor.code_bits}-bit codes: load the instrument that the packets come from"
        )


def batches(scanner: Scanner, packets: Buffer) -> Iterator[Buffer]:
    """Scan a whole stream; for each batch of frames give the bytes that the tables refer to."""
    whole = memoryview(packets).cast("B") if len(packets) else memoryview(b"")
    base = 0
    while True:
        window = whole[base : base + WINDOW_BYTES]
        final = base + len(window) == len(whole)
        position = 0
        while True:
            found = scanner.scan(window, position, final=final)
            position = found.position
            if scanner.frames:
                yield window
                scanner.clear()
            if found.ended:
                break
        if final:
            return
        base += position
