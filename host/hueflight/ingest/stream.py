"""Live histograms: bytes in as they come, a histogram out for every block of frames."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from hueflight.errors import IngestError
from hueflight.ingest import kernels as backends
from hueflight.ingest.accumulate import checked_threads, frames_by_step
from hueflight.ingest.accumulator import Counts, Overflow, Table, check_overflow
from hueflight.ingest.buffer import BUFFER_BYTES, PacketBuffer, pieces
from hueflight.ingest.kernels import Kernels
from hueflight.ingest.report import IngestReport
from hueflight.model.instrument import Instrument


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """A histogram of consecutive frames.

    Attributes
    ----------
    counts : dict of arrays (row, col, code), by step of the illuminator
        One entry, under 0, unless steps are kept apart.
    frames : how many frames are in it.
    first_frame, last_frame : their numbers as the camera counts.
    first_tick, last_tick : device clock at the start of the first and last exposure.
    clock_hz : ticks per second.
    report : what the whole stream has brought up to here.
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
        """The only histogram of a block that does not keep steps apart."""
        return self.counts[0]


class HistogramStream:
    """Counts a stream that comes in pieces, and gives a `Block` for every `block_frames`.

    Memory is bounded whatever the stream's length: the buffer, one table of counts per step, and
    for sliding windows one per block in the window.

    Parameters
    ----------
    instrument : Instrument
        States geometry and code width.
    block_frames : int, optional
        Frames per block: 620 at 18 600 frames per second are 30 blocks per second. Without it
        there is one block, when `finish` is called.
    window_blocks : int
        Each histogram is the sum of the latest so many blocks: a sliding window.
    by_step : bool
        Keep one histogram for each step of the illuminator; by default all frames count together.
    overflow : Overflow
        What to do when a counter is full; see `accumulate`.
    threads : int
        Threads over pixels.
    buffer_bytes : int
        Bytes of packets held back before they are counted.

    Raises
    ------
    IngestError, OverflowPolicyError
        If an option makes no sense.
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
        self._window = _Window(window_blocks, instrument.histogram_shape)
        self._tables: dict[int, Table] = {}
        self._spare: list[Counts] = []
        self._counted = 0  # frames of the block that are in the tables
        self._span: list[int] = []  # frame numbers and ticks, of the first and the last
        self._clock_hz = 0
        self._photons = self._clipped = 0

    @property
    def report(self) -> IngestReport:
        """Totals so far; photons up to what has been counted."""
        return IngestReport.from_state(
            self._buffer.scanner.state, photons=self._photons, clipped=self._clipped
        )

    @property
    def pending_bytes(self) -> int:
        """Bytes held back until their packet is complete."""
        return self._buffer.pending

    def take_others(self) -> list[bytes]:
        """Packets since the last call that are not frames: events, status, test patterns."""
        taken, self._buffer.others = self._buffer.others, []
        return taken

    def writable(self) -> memoryview:
        """Where the next bytes of the stream go: `recv_into` it, then `commit`."""
        return self._buffer.writable()

    def commit(self, size: int, /) -> list[Block]:
        """Say that `size` bytes have been received; return the blocks that they complete."""
        self._buffer.commit(size)
        return self._advance(final=False)

    def feed(self, data: bytes | bytearray | memoryview, /) -> list[Block]:
        """Take the next bytes of the stream; return the blocks that they complete."""
        blocks: list[Block] = []
        for _ in pieces(self._buffer, data):
            blocks += self._advance(final=False)
        return blocks

    def finish(self) -> list[Block]:
        """Say that the stream has ended; return the last block, which may be shorter."""
        blocks = self._advance(final=True)
        return [*blocks, self._emit()] if self._counted or not self._block_frames else blocks

    def recycle(self, block: Block, /) -> None:
        """Give back a block that is no longer needed, so that its memory serves again."""
        self._spare += [counts for counts in block.counts.values() if counts.dtype == np.uint16]

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
        """Add the frames at hand to the tables."""
        scanner = self._buffer.scanner
        if not scanner.frames:
            return
        for step, position, chosen in frames_by_step(scanner):
            table = self._table(step if self._by_step else 0)
            photons, clipped = table.photons, table.clipped
            first_row = position * self.instrument.sensor.rows
            table.add(self._buffer.data, scanner, chosen, first_row=first_row)
            self._photons += table.photons - photons
            self._clipped += table.clipped - clipped
        headers = scanner.header_fields()
        ends = [int(headers[i][name]) for name in ("frame", "timestamp") for i in (0, -1)]
        self._span = [self._span[0], ends[1], self._span[2], ends[3]] if self._span else ends
        self._clock_hz = int(headers[-1]["clock_hz"])
        self._counted += scanner.frames

    def _table(self, step: int) -> Table:
        if step not in self._tables:
            self._tables[step] = Table(
                *self.instrument.image_shape,
                self.instrument.sensor.code_bits,
                kernels=self._kernels,
                overflow=self._overflow,
                reuse=self._spare.pop() if self._spare else None,
                threads=self._threads,
            )
        return self._tables[step]

    def _emit(self) -> Block:
        if not self._tables and not self._by_step:
            self._table(0)
        counts = {step: self._tables[step].finish() for step in sorted(self._tables)}
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
        self._tables, self._counted, self._span = {}, 0, []
        return self._window.slide(block)


class _Window:
    """Sum of the latest blocks: adds the new one, takes the oldest away."""

    def __init__(self, blocks: int, shape: tuple[int, int, int]) -> None:
        self._blocks: deque[Block] = deque(maxlen=blocks)
        self._sums: dict[int, Counts] = {}
        self._shape = shape

    def slide(self, block: Block) -> Block:
        if self._blocks.maxlen == 1:
            return block
        if len(self._blocks) == self._blocks.maxlen:
            for step, counts in self._blocks[0].counts.items():
                self._sums[step] -= counts
        self._blocks.append(block)
        for step, counts in block.counts.items():
            if step not in self._sums:
                self._sums[step] = np.zeros(self._shape, np.uint32)
            self._sums[step] += counts
        kept = {step for each in self._blocks for step in each.counts}
        self._sums = {step: self._sums[step] for step in sorted(kept)}
        first = self._blocks[0]
        return replace(
            block,
            counts={step: counts.copy() for step, counts in self._sums.items()},
            frames=sum(each.frames for each in self._blocks),
            first_frame=first.first_frame,
            first_tick=first.first_tick,
        )
