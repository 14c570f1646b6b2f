"""A table of counts that frames are added to, and what happens when a counter is full."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HistogramError, OverflowPolicyError
from hueflight.ingest.kernels import (
    ADD,
    MOST_FRAMES,
    SATURATE,
    STORE,
    SUBTRACT,
    TILE,
    Buffer,
    Kernels,
)
from hueflight.ingest.scanner import Scanner

Overflow = Literal["error", "saturate", "widen"]
Counts = NDArray[np.unsignedinteger[Any]]


def check_overflow(policy: str, /) -> None:
    """Refuse a policy that does not exist."""
    if policy not in get_args(Overflow):
        raise OverflowPolicyError(
            f"overflow = {policy!r}: must be one of {', '.join(get_args(Overflow))}"
        )


def check_out(out: Counts, shape: tuple[int, ...], /) -> None:
    """Refuse an array that the kernels can't count into."""
    if not isinstance(out, np.ndarray) or out.shape != shape:
        raise HistogramError(f"out has shape {np.shape(out)}: must be {shape}, (row, col, code)")
    if out.dtype not in (np.uint16, np.uint32):
        raise HistogramError(f"out is {out.dtype}: must be uint16 or uint32")
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise HistogramError("out must be writeable and C-contiguous, not a strided view")


def full_error(dtype: np.dtype[Any], frames: int, /) -> OverflowPolicyError:
    """The error of a counter that would not hold the sum."""
    way_out = "use overflow='widen' or 'saturate', or 32-bit counts"
    if dtype == np.uint32:
        way_out = "start a new histogram"
    return OverflowPolicyError(
        f"with {frames} more frames a counter would exceed {np.iinfo(dtype).max}, the largest "
        f"{dtype} number: {way_out}"
    )


class Table:
    """Counts (row, col, code) of one sensor.

    Parameters
    ----------
    rows, cols, code_bits : int
        Geometry; for a scanned sensor, of the whole image.
    overflow : Overflow
        What to do when a counter is full: raise ``"error"`` with the counts as they were;
        ``"saturate"`` and count what was clipped; ``"widen"`` to 32 bits, which is exact.
    out : array (rows, cols, 2**code_bits), optional
        Counts to add to, uint16 or uint32; by default new ones of 16 bits.
    reuse : uint16 array, optional
        Memory for new counts; what is in it does not matter.
    threads : int
        Threads over pixels.

    Attributes
    ----------
    counts : the array; another one after widening.
    photons, clipped : totals.
    """

    def __init__(
        self,
        rows: int,
        cols: int,
        code_bits: int,
        *,
        kernels: Kernels,
        overflow: Overflow,
        out: Counts | None = None,
        reuse: Counts | None = None,
        threads: int = 1,
    ) -> None:
        shape = (rows, cols, 1 << code_bits)
        self._kernels, self._overflow, self._threads = kernels, overflow, threads
        self._cols, self._code_bits = cols, code_bits
        # a new table is only written to: zeros would be set twice
        self._unwritten = [] if out is not None else [(0, rows)]
        if out is None:
            out = np.empty(shape, np.uint16) if reuse is None else reuse
        self.counts: Counts = out
        self.photons = 0
        self.clipped = 0

    def add(
        self, data: Buffer, frames: Scanner, chosen: NDArray[np.uint32], *, first_row: int = 0
    ) -> None:
        """Add the `chosen` frames at hand in a scanner to the rows from `first_row` on.

        Raises
        ------
        OverflowPolicyError
            Under the policy ``"error"``, if a counter would not hold the sum. The counts are
            then what they were before.
        """
        rows = frames.sensor.rows
        fresh = self._unwritten == [(0, self.counts.shape[0])] and rows == self.counts.shape[0]
        if not fresh:
            self._zero()
        for at in range(0, chosen.size, MOST_FRAMES):
            self._add(data, frames, chosen[at : at + MOST_FRAMES], first_row, fresh and at == 0)
        self._unwritten = []

    def _zero(self) -> None:
        for start, stop in self._unwritten:
            self.counts[start:stop] = 0
        self._unwritten = []

    def _add(
        self, data: Buffer, frames: Scanner, chosen: NDArray[np.uint32], row: int, fresh: bool
    ) -> None:
        mode = STORE if fresh else SATURATE if self._overflow == "saturate" else ADD
        rows = slice(row, row + frames.sensor.rows)
        chunks = -(-frames.sensor.rows * frames.sensor.cols // frames.run)
        done = np.zeros((chunks, -(-frames.run // TILE)), np.uint8)
        left = self._run(data, frames, chosen, rows, mode, done)
        if left and (self._overflow == "error" or self.counts.dtype == np.uint32):
            self._run(data, frames, chosen, rows, SUBTRACT, done)
            raise full_error(self.counts.dtype, chosen.size)
        if left:
            self.counts = self.counts.astype(np.uint32)
            self._run(data, frames, chosen, rows, ADD, done)

    def _run(
        self,
        data: Buffer,
        frames: Scanner,
        chosen: NDArray[np.uint32],
        rows: slice,
        mode: int,
        done: NDArray[np.uint8],
    ) -> int:
        """Let the kernel loose on all chunks; return the tiles that it left alone."""
        out = self.counts[rows]
        pixels = out.shape[0] * self._cols

        def work(begin: int, end: int) -> tuple[int, int, int]:
            return self._kernels.count(
                data,
                frames.chunks,
                frames.stride,
                chosen,
                pixels,
                self._code_bits,
                frames.run,
                out,
                out.dtype == np.uint32,
                mode,
                done,
                begin,
                end,
            )

        parts = min(self._threads, len(done))
        cuts = [len(done) * part // parts for part in range(parts + 1)]
        if len(cuts) == 2:
            results = [work(*cuts)]
        else:
            with ThreadPoolExecutor(len(cuts) - 1) as pool:
                results = list(pool.map(work, cuts[:-1], cuts[1:]))
        photons, clipped, left = (sum(column) for column in zip(*results, strict=True))
        sign = -1 if mode == SUBTRACT else 1
        self.photons += sign * photons
        self.clipped += clipped
        return left

    def finish(self) -> Counts:
        """The counts, zeros included where no frame came."""
        self._zero()
        return self.counts
