# SPDX-License-Identifier: Apache-2.0
"""Counts that frames are added to, and the policies for a counter that is full."""

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
    """Raise an error if there is no such overflow policy."""
    if policy not in get_args(Overflow):
        raise OverflowPolicyError(
            f"overflow = {policy!r}: must be one of {', '.join(get_args(Overflow))}"
        )


def check_out(out: Counts, shape: tuple[int, ...], /) -> None:
    """Raise an error if the kernels can't count into this array."""
    if not isinstance(out, np.ndarray) or out.shape != shape:
        raise HistogramError(f"out has shape {np.shape(out)}: must be {shape}, (row, col, code)")
    if out.dtype not in (np.uint16, np.uint32):
        raise HistogramError(f"out is {out.dtype}: must be uint16 or uint32")
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise HistogramError("out must be writeable and C-contiguous, not a strided view")


def full_error(dtype: np.dtype[Any], frames: int, /) -> OverflowPolicyError:
    """Return the error for a counter that would overflow."""
    way_out = "use overflow='widen' or 'saturate', or 32-bit counts"
    if dtype == np.uint32:
        way_out = "start a new histogram"
    return OverflowPolicyError(
        f"with {frames} more frames a counter would exceed {np.iinfo(dtype).max}, the largest "
        f"{dtype} number: {way_out}"
    )


class HistogramAccumulator:
    """Histogram (row, col, code) of one sensor, to which scanned frames are added.

    Parameters
    ----------
    rows, cols, code_bits : int
        Geometry and code width; for a scanned sensor, those of the whole image.
    kernels : Kernels
        Backend that counts.
    overflow : {"error", "saturate", "widen"}
        Policy for a counter that is full: raise an error and leave the counts unchanged; keep the
        largest count and record how many were clipped; or continue with 32 bits, which is exact.
    out : numpy.ndarray, uint16 or uint32, shape (rows, cols, 2**code_bits), optional
        Counts to add to; by default new ones of 16 bits.
    reuse : numpy.ndarray, uint16, shape (rows, cols, 2**code_bits), optional
        Memory for new counts, whose content is overwritten.
    threads : int
        Number of threads, which share the pixels.

    Attributes
    ----------
    counts : numpy.ndarray, uint16 or uint32, shape (rows, cols, 2**code_bits)
        The counts; after widening this is another array.
    photons : int
        Number of photons counted.
    clipped : int
        Number of counts lost under the policy ``"saturate"``.
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
        # the first frames overwrite new counts, so that zeroing them first would be a waste
        self._unwritten = [] if out is not None else [(0, rows)]
        if out is None:
            out = np.empty(shape, np.uint16) if reuse is None else reuse
        self.counts: Counts = out
        self.photons = 0
        self.clipped = 0

    def add(
        self, data: Buffer, frames: Scanner, chosen: NDArray[np.uint32], *, first_row: int = 0
    ) -> None:
        """Add frames of a scanner to the counts.

        Parameters
        ----------
        data : bytes-like
            Bytes that the tables of the scanner refer to.
        frames : Scanner
            Scanner that holds the frames.
        chosen : numpy.ndarray, uint32, shape (frame,)
            Indices of the frames to add.
        first_row : int
            Row of the image that the first row of the sensor is added to.

        Raises
        ------
        OverflowPolicyError
            If a counter would overflow under the policy ``"error"``. The counts are then
            unchanged.
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
        """Run the kernel on all chunks; return the number of tiles that it left out."""
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
        """Return the counts, with zeros where no frame was added."""
        self._zero()
        return self.counts
