# SPDX-License-Identifier: Apache-2.0
"""Live histograms: a stream of bytes in, a histogram for every block of frames out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from hueflight.errors import IngestError
from hueflight.ingest import kernels as backends
from hueflight.ingest.accumulate import checked_threads, frames_by_step
from hueflight.ingest.accumulator import Counts, HistogramAccumulator, Overflow, check_overflow
from hueflight.ingest.buffer import BUFFER_BYTES, PacketBuffer, pieces
from hueflight.ingest.kernels import Kernels
from hueflight.ingest.report import IngestReport
from hueflight.ingest.sliding_sum import SlidingSum
from hueflight.model.instrument import Instrument

MOST_SPARE = 3  #: histograms that wait to be used again; more would only occupy memory


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """A histogram of consecutive frames.

    Attributes
    ----------
    counts : dict of int to numpy.ndarray
        Histogram (row, col, code) for each step of the illuminator; a single one, under 0, unless
        steps are kept separate.
    frames : int
        Number of frames.
    first_frame, last_frame : int
        Frame numbers of the first and last frame, as counted by the camera.
    first_tick, last_tick : int
        Device clock at the start of the first and last exposure, in ticks.
    clock_hz : int
        Ticks per second of the device clock.
    report : IngestReport
        Totals of the whole stream up to the end of the block.
    """

    counts: dict[int, Counts]
    frames: int
    first_frame: int
    last_frame: int
    first_tick: int
    last_tick: int
    clock_hz: int
    report: IngestReport

    @property
    def histogram(self) -> Counts:
        """The histogram of a block that does not keep steps separate."""
        return self.counts[0]


class HistogramStream:
    """Counts a stream that arrives in pieces and gives a `Block` for every `block_frames` frames.

    Memory is bounded whatever the length of the stream: a buffer, one histogram per step, and one
    per block of a sliding window.

    Parameters
    ----------
    instrument : Instrument
        Instrument that states geometry and code width.
    block_frames : int, optional
        Frames per block; 620 at 18 600 frames per second give 30 blocks per second. By default
        there is one block, which `finish` returns.
    window_blocks : int
        Number of latest blocks whose sum each histogram is, as a sliding window.
    by_step : bool
        Whether to keep one histogram for each step of the illuminator. By default all frames are
        counted together.
    overflow : {"error", "saturate", "widen"}
        Policy for a counter that is full; see `accumulate`.
    threads : int
        Number of threads, which share the pixels.
    buffer_bytes : int
        Size of the buffer for packets that have not been counted yet.
    kernels : Kernels, optional
        Backend; by default the fastest one (see `kernels.choose`).

    Raises
    ------
    IngestError
        If `block_frames`, `window_blocks`, `threads` or `buffer_bytes` is out of range.
    OverflowPolicyError
        If there is no such policy.
    """

    def __init__(
        self,
        instrument: Instrument,
        /,
        *,
        block_frames: int | None = None,
        window_blocks: int = 1,
        by_step: bool = False,
        overflow: Overflow = "widen",
        threads: int = 1,
        buffer_bytes: int = BUFFER_BYTES,
        kernels: Kernels | None = None,
    ) -> None:
        check_overflow(overflow)
        if block_frames is not None and block_frames < 1:
            raise IngestError(f"block_frames = {block_frames}: must be at least 1")
        if window_blocks < 1 or (window_blocks > 1 and block_frames is None):
            raise IngestError(
                f"window_blocks = {window_blocks}: must be at least 1, and needs block_frames"
            )
        self.instrument = instrument
        self._overflow: Overflow = overflow
        self._block_frames, self._by_step = block_frames, by_step
        self._threads = checked_threads(threads)
        self._kernels = kernels or backends.choose()
        self._buffer = PacketBuffer(instrument.sensor, self._kernels, capacity=buffer_bytes)
        self._window = _Window(window_blocks)
        self._accumulators: dict[int, HistogramAccumulator] = {}
        self._spare: list[Counts] = []
        self._counted = 0  # frames of the current block
        self._span: list[int] = []  # frame numbers and ticks of the first and last frame
        self._clock_hz = 0
        self._photons = self._clipped = 0

    @property
    def report(self) -> IngestReport:
        """Totals so far; the photons are those of frames that have been counted."""
        return IngestReport.from_state(
            self._buffer.scanner.state, photons=self._photons, clipped=self._clipped
        )

    @property
    def pending_bytes(self) -> int:
        """Number of bytes of the packet that is still incomplete."""
        return self._buffer.pending

    def take_others(self) -> list[bytes]:
        """Return the packets since the last call that are not frames.

        Returns
        -------
        list of bytes
            Packets with events, status or test patterns, as received.
        """
        taken, self._buffer.others = self._buffer.others, []
        return taken

    def writable(self) -> memoryview:
        """Return the memory for the next bytes of the stream.

        Returns
        -------
        memoryview
            Memory to `recv_into`, before a call of `commit`.
        """
        return self._buffer.writable()

    def commit(self, size: int, /) -> list[Block]:
        """Record that bytes have been received into `writable`.

        Parameters
        ----------
        size : int
            Number of bytes.

        Returns
        -------
        list of Block
            The blocks that these bytes complete.
        """
        self._buffer.commit(size)
        return self._advance(final=False)

    def feed(self, data: bytes | bytearray | memoryview, /) -> list[Block]:
        """Take the next bytes of the stream.

        Parameters
        ----------
        data : bytes-like
            Any number of bytes; packets may be split anywhere.

        Returns
        -------
        list of Block
            The blocks that these bytes complete.
        """
        blocks: list[Block] = []
        for _ in pieces(self._buffer, data):
            blocks += self._advance(final=False)
        return blocks

    def finish(self) -> list[Block]:
        """End the stream.

        Returns
        -------
        list of Block
            The remaining blocks, the last of which may be shorter.
        """
        blocks = self._advance(final=True)
        return [*blocks, self._emit()] if self._counted or not self._block_frames else blocks

    def recycle(self, block: Block, /) -> None:
        """Give back a block that is no longer needed, so that its memory is reused.

        Parameters
        ----------
        block : Block
            A block of this stream.
        """
        given = [counts for counts in block.counts.values() if counts.dtype == np.uint16]
        self._spare += given[: max(0, MOST_SPARE - len(self._spare))]

    def _advance(self, *, final: bool) -> list[Block]:
        blocks: list[Block] = []
        buffer, scanner = self._buffer, self._buffer.scanner
        while True:
            left = self._block_frames - self._counted if self._block_frames else scanner.limit
            ended = buffer.scan(limit=min(left, scanner.limit), final=final)
            whole = self._block_frames is not None and scanner.frames == left
            if not ended or whole or buffer.tight or final:
                self._count()
                buffer.release()
            if whole:
                blocks.append(self._emit())
            if ended:
                return blocks

    def _count(self) -> None:
        """Add the frames in the buffer to the histograms."""
        scanner = self._buffer.scanner
        if not scanner.frames:
            return
        for step, position, chosen in frames_by_step(scanner):
            accumulator = self._accumulator(step if self._by_step else 0)
            photons, clipped = accumulator.photons, accumulator.clipped
            first_row = position * self.instrument.sensor.rows
            accumulator.add(self._buffer.data, scanner, chosen, first_row=first_row)
            self._photons += accumulator.photons - photons
            self._clipped += accumulator.clipped - clipped
        headers = scanner.header_fields()
        ends = [int(headers[i][name]) for name in ("frame", "timestamp") for i in (0, -1)]
        self._span = [self._span[0], ends[1], self._span[2], ends[3]] if self._span else ends
        self._clock_hz = int(headers[-1]["clock_hz"])
        self._counted += scanner.frames

    def _accumulator(self, step: int) -> HistogramAccumulator:
        if step not in self._accumulators:
            self._accumulators[step] = HistogramAccumulator(
                *self.instrument.image_shape,
                self.instrument.sensor.code_bits,
                kernels=self._kernels,
                overflow=self._overflow,
                reuse=self._spare.pop() if self._spare else None,
                threads=self._threads,
            )
        return self._accumulators[step]

    def _emit(self) -> Block:
        if not self._accumulators and not self._by_step:
            self._accumulator(0)
        counts = {step: self._accumulators[step].finish() for step in sorted(self._accumulators)}
        first_frame, last_frame, first_tick, last_tick = self._span or (0, 0, 0, 0)
        block = Block(
            counts=counts,
            frames=self._counted,
            first_frame=first_frame,
            last_frame=last_frame,
            first_tick=first_tick,
            last_tick=last_tick,
            clock_hz=self._clock_hz,
            report=self.report,
        )
        self._accumulators, self._counted, self._span = {}, 0, []
        return self._window.slide(block)


class _Window:
    """The latest blocks, merged into one."""

    def __init__(self, blocks: int) -> None:
        self._blocks: deque[Block] = deque(maxlen=blocks)
        self._sum = SlidingSum(blocks, dtype=np.uint32)

    def slide(self, block: Block) -> Block:
        if self._blocks.maxlen == 1:
            return block
        self._blocks.append(block)
        self._sum.add(block.counts, block.frames)
        first = self._blocks[0]
        return replace(
            block,
            counts={step: counts.copy() for step, counts in self._sum.sums.items()},
            frames=self._sum.frames,
            first_frame=first.first_frame,
            first_tick=first.first_tick,
        )
