# SPDX-License-Identifier: Apache-2.0
"""Packets to histograms in one call."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hueflight.errors import HistogramError, IngestError
from hueflight.ingest import kernels as backends
from hueflight.ingest.accumulator import (
    Counts,
    HistogramAccumulator,
    Overflow,
    check_out,
    check_overflow,
    full_error,
)
from hueflight.ingest.kernels import Buffer, Kernels
from hueflight.ingest.report import IngestReport
from hueflight.ingest.scanner import Scanner, batches
from hueflight.model.instrument import Instrument


def accumulate(
    packets: Buffer,
    instrument: Instrument,
    /,
    *,
    out: Counts | None = None,
    threads: int = 1,
    overflow: Overflow = "error",
    kernels: Kernels | None = None,
) -> tuple[Counts, IngestReport]:
    """Count the codes of all frames in a stream of packets.

    For a scanned sensor (``sensor.scan_steps`` above 1) the step marker of a frame, modulo the
    number of positions, is its position p: its codes are counted into the rows from
    ``p * sensor.rows`` on.

    Parameters
    ----------
    packets : bytes-like
        Complete packets; damage in and between them is skipped and reported.
    instrument : Instrument
        Instrument that states geometry and code width.
    out : numpy.ndarray, uint16 or uint32, shape (row, col, code), optional
        Counts to add to. By default new ones of 16 bits, which widen to 32 bits where needed.
    threads : int
        Number of threads, which share the pixels.
    overflow : {"error", "saturate", "widen"}
        Policy for a counter of `out` that is full. Under ``"widen"`` the returned array may be
        another one than `out`.
    kernels : Kernels, optional
        Backend; by default the fastest one (see `kernels.choose`).

    Returns
    -------
    counts : numpy.ndarray, uint16 or uint32, shape (row, col, code)
        Code 0 counts the frames that have no other code for a pixel: exposures without a photon,
        and codes that the camera left out.
    report : IngestReport
        Totals of what was received and of what was lost.

    Raises
    ------
    IngestError
        If frames have another geometry than the instrument.
    HistogramError
        If `out` does not fit the instrument.
    OverflowPolicyError
        If a counter is full under the policy ``"error"``. The batches of frames counted before
        remain in `out`.
    """
    check_overflow(overflow)
    if out is not None:
        check_out(out, instrument.histogram_shape)
    chosen_kernels = kernels or backends.choose()
    scanner = Scanner(instrument.sensor, chosen_kernels)
    accumulator = HistogramAccumulator(
        *instrument.image_shape,
        instrument.sensor.code_bits,
        kernels=chosen_kernels,
        overflow=overflow if out is not None else "widen",
        out=out,
        threads=checked_threads(threads),
    )
    for data in batches(scanner, packets):
        scanner.refuse_foreign()
        for _, position, chosen in frames_by_step(scanner):
            accumulator.add(data, scanner, chosen, first_row=position * instrument.sensor.rows)
    scanner.refuse_foreign()
    counts = accumulator.finish()
    return counts, IngestReport.from_state(
        scanner.state, photons=accumulator.photons, clipped=accumulator.clipped
    )


def accumulate_by_step(
    packets: Buffer,
    instrument: Instrument,
    /,
    *,
    threads: int = 1,
    kernels: Kernels | None = None,
) -> tuple[dict[int, Counts], IngestReport]:
    """Count the codes of all frames, with one histogram for each step of the illuminator.

    This is meant for captures with one LED at a time, whose frames carry a step marker. For a
    scanned sensor a step is one scan: the step marker divided by the number of positions.

    Parameters
    ----------
    packets : bytes-like
        Complete packets; damage in and between them is skipped and reported.
    instrument : Instrument
        Instrument that states geometry and code width.
    threads : int
        Number of threads, which share the pixels.
    kernels : Kernels, optional
        Backend; by default the fastest one (see `kernels.choose`).

    Returns
    -------
    counts : dict of int to numpy.ndarray
        Histogram (row, col, code) of each step, in ascending order of the steps; uint16, or uint32
        where 16 bits are too few.
    report : IngestReport
        Totals of what was received and of what was lost.

    Raises
    ------
    IngestError
        If frames have another geometry than the instrument.
    """
    scanner = Scanner(instrument.sensor, kernels or backends.choose())
    accumulators: dict[int, HistogramAccumulator] = {}
    for data in batches(scanner, packets):
        scanner.refuse_foreign()
        for step, position, chosen in frames_by_step(scanner):
            if step not in accumulators:
                accumulators[step] = HistogramAccumulator(
                    *instrument.image_shape,
                    instrument.sensor.code_bits,
                    kernels=scanner.kernels,
                    overflow="widen",
                    threads=checked_threads(threads),
                )
            first_row = position * instrument.sensor.rows
            accumulators[step].add(data, scanner, chosen, first_row=first_row)
    scanner.refuse_foreign()
    photons = sum(accumulator.photons for accumulator in accumulators.values())
    report = IngestReport.from_state(scanner.state, photons=photons)
    return {step: accumulators[step].finish() for step in sorted(accumulators)}, report


def accumulate_codes(
    codes: ArrayLike,
    instrument: Instrument,
    /,
    *,
    out: Counts | None = None,
    overflow: Overflow = "error",
) -> Counts:
    """Count codes that are in memory as plain numbers.

    Parameters
    ----------
    codes : array_like of int, shape (frame, row, col) or (row, col)
        Codes of each frame; 0 = no photon where the sensor reports that.
    instrument : Instrument
        Instrument that states geometry and code width.
    out : numpy.ndarray, uint16 or uint32, shape (row, col, code), optional
        Counts to add to, which are left unchanged if an error is raised. By default new ones.
    overflow : {"error", "saturate", "widen"}
        Policy for a counter of `out` that is full, as in `accumulate`.

    Returns
    -------
    numpy.ndarray, uint16 or uint32, shape (row, col, code)
        The counts.

    Raises
    ------
    HistogramError
        If `codes` or `out` do not fit the instrument.
    OverflowPolicyError
        If a counter is full under the policy ``"error"``.
    """
    check_overflow(overflow)
    values = np.asarray(codes)
    shape = instrument.image_shape
    if values.ndim == 2:
        values = values[None]
    if values.ndim != 3 or values.shape[1:] != shape:
        raise HistogramError(
            f"codes have shape {np.shape(codes)}: must be (frame, row, col) with {shape[0]} × "
            f"{shape[1]} pixels"
        )
    if not np.issubdtype(values.dtype, np.integer):
        raise HistogramError(f"codes are {values.dtype}: must be integers")
    if values.size and not (values.min() >= 0 and values.max() < instrument.sensor.codes):
        bad = int(values.min() if values.min() < 0 else values.max())
        raise HistogramError(f"code {bad}: must be from 0 to {instrument.sensor.codes - 1}")
    if out is None:
        dtype = np.uint16 if len(values) <= np.iinfo(np.uint16).max else np.uint32
        out, overflow = np.zeros(instrument.histogram_shape, dtype), "error"
    check_out(out, instrument.histogram_shape)
    return _add_codes(values, out, overflow)


def _add_codes(values: NDArray[np.integer], out: Counts, overflow: Overflow) -> Counts:
    limit = int(np.iinfo(out.dtype).max)
    codes = out.shape[-1]
    if overflow != "saturate" and out.size and int(out.max()) + len(values) > limit:
        # by rows, to save memory; nothing is added before all rows are known to fit
        full = any(
            (out[row] > limit - _row_counts(values[:, row], codes)).any() for row in range(len(out))
        )
        if full and (overflow == "error" or out.dtype == np.uint32):
            raise full_error(out.dtype, len(values))
        if full:
            out = out.astype(np.uint32)
    for row, counts in enumerate(out):
        seen = _row_counts(values[:, row], codes)
        if overflow == "saturate":
            seen = np.minimum(seen, limit - counts.astype(np.intp))
        counts += seen.astype(out.dtype)
    return out


def _row_counts(values: NDArray[np.integer], codes: int) -> NDArray[np.intp]:
    """Count the codes (frame, col) of one row, as (col, code)."""
    cols = values.shape[1]
    index = values.astype(np.intp) + np.arange(cols) * codes
    return np.bincount(index.reshape(-1), minlength=cols * codes).reshape(cols, codes)


def checked_threads(threads: int, /) -> int:
    """Return `threads` if it is a valid number of threads."""
    if threads < 1:
        raise IngestError(f"threads = {threads}: must be at least 1")
    return threads


def frames_by_step(scanner: Scanner, /) -> list[tuple[int, int, NDArray[np.uint32]]]:
    """Return the steps and scan positions of the scanned frames, and the frames that have each."""
    if not scanner.frames:
        return []
    markers = scanner.header_fields()["step"]
    positions = scanner.sensor.scan_steps
    if (markers == markers[0]).all():
        return [(*divmod(int(markers[0]), positions), np.arange(len(markers), dtype=np.uint32))]
    return [
        (*divmod(int(marker), positions), np.flatnonzero(markers == marker).astype(np.uint32))
        for marker in np.unique(markers)
    ]
