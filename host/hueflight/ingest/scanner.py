# SPDX-License-Identifier: Apache-2.0
"""Scanning of a stream in pieces: the tables that the kernels fill, and the state in between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import IngestError
from hueflight.ingest.kernels import STATE, Buffer, Kernels, Scanned
from hueflight.model.instrument import Sensor
from hueflight_protocol.wire import DEFAULT_RUN, FRAME_HEADER, MAX_CHUNKS

BATCH_FRAMES = 1024  # frames counted together, few enough that their packets stay in the cache
WINDOW_BYTES = 1 << 30  # scanned at a time; offsets in the tables have 32 bits
OTHERS = 64
CARRIED = ("in_step", "has_sequence", "sequence", "has_dropped", "capture", "last_dropped")


@dataclass(slots=True)
class Scanner:
    """Finds the frames of one sensor in a stream that comes in pieces.

    Parameters
    ----------
    sensor : Sensor
        Sensor whose frames are wanted; frames of another geometry or code width are counted as
        foreign.
    kernels : Kernels
        Backend that scans.
    limit : int
        Largest number of frames that are held at a time.

    Attributes
    ----------
    state : numpy.ndarray, int64
        State and totals, in the order of `kernels.STATE`.
    chunks : numpy.ndarray, uint64
        Entries of the chunks of the frames; see `numpy_scan.scan`.
    headers : numpy.ndarray, uint8, shape (limit, 64)
        Headers of the frames.
    places : numpy.ndarray, uint64, shape (limit, 2)
        Offset and size of each frame.
    others : numpy.ndarray, uint64, shape (n, 2)
        Offset and size of packets that are not frames.
    frames : int
        Number of frames in the tables.
    run : int
        Run length of these frames, in pixels.
    stride : int
        Number of frames per chunk in `chunks`.
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
        # Fewer frames fit for shorter run lengths. Rows are longer than the limit by a cache line,
        # because a power of two as stride gives cache conflicts between the entries of a frame.
        self.chunks = np.zeros(max(MAX_CHUNKS, chunks * (self.limit + 8)), np.uint64)
        self.headers = np.zeros((self.limit, FRAME_HEADER.size), np.uint8)
        self.places = np.zeros((self.limit, 2), np.uint64)
        self.others = np.zeros((OTHERS, 2), np.uint64)

    def scan(self, data: Buffer, start: int, *, final: bool, limit: int | None = None) -> Scanned:
        """Continue from byte `start` and add frames to the tables until there are `limit`."""
        before = self.state.copy()
        try:
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
        except MemoryError:  # the packets will be scanned again, and must not count twice
            self.state[:] = before
            raise
        self.frames, self.run, self.stride = found.frames, found.run, found.stride
        return found

    def clear(self) -> None:
        """Remove the frames from the tables, but keep the totals."""
        self.frames = 0

    def reset_totals(self) -> None:
        """Set the totals to 0, but keep the state that is carried from packet to packet."""
        for number, name in enumerate(STATE):
            if name not in CARRIED:
                self.state[number] = 0

    def header_fields(self) -> NDArray[np.void]:
        """Return the headers of the frames in the tables, as a structured array (frame,)."""
        return self.headers[: self.frames].reshape(-1).view(FRAME_HEADER.dtype)

    def total(self, name: str) -> int:
        """Return one of the totals in `state`."""
        return int(self.state[STATE.index(name)])

    def refuse_foreign(self) -> None:
        """Raise an error if there were frames of another sensor.

        Raises
        ------
        IngestError
            If there were any; the message states both geometries.
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
    """Scan a whole stream; yield the bytes that the tables refer to for each batch of frames."""
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
