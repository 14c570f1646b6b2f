"""From packets to an image in one call: counted and fitted on the same threads."""

from __future__ import annotations

import numpy as np
import xarray as xr

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError
from hueflight.ingest import IngestReport, accumulate
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.kernels import Buffer
from hueflight.reconstruction.options import DEFAULT_SKIPS, Skips
from hueflight.reconstruction.reconstruct import reconstruct


def reconstruct_packets(
    packets: Buffer,
    calibration: Calibration,
    /,
    *,
    out: Counts | None = None,
    depth_range: tuple[float, float] | None = None,
    pileup_correction: bool = True,
    skips: Skips = DEFAULT_SKIPS,
    threads: int = 1,
) -> tuple[xr.Dataset, IngestReport]:
    """Reconstruct depth and reflectance in every band from a stream of packets, by the joint fit.

    Parameters
    ----------
    packets : bytes-like
        Whole packets of frames; damage is skipped and reported.
    calibration : Calibration
        Calibration of the same instrument.
    out : ndarray of uint16 or uint32, shape (row, col, code), optional
        Working memory for the counts, which is cleared first. Reusing it saves the time that new
        memory takes.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search, m; see `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    skips : Skips
        What the fit may leave out.
    threads : int
        Threads that share the pixels, first of counting, then of fitting.

    Returns
    -------
    image : Dataset
        Image as `reconstruct` gives it.
    report : IngestReport
        Frames that were counted, and damage.

    Raises
    ------
    IngestError
        If frames have another geometry than the instrument.
    HistogramError
        If there is no frame, or `out` does not fit the instrument.
    """
    if out is not None:
        out.fill(0)
    counts, report = accumulate(packets, calibration.instrument, out=out, threads=threads)
    if not report.frames:
        raise HistogramError(
            "the packets hold not one frame: check that the capture ran and the file is whole"
        )
    frames = None
    if calibration.instrument.sensor.reports_empty:
        # every exposure of a row counts once in each of its pixels
        frames = np.broadcast_to(counts[:, :1].sum(axis=-1), counts.shape[:2])
    image = reconstruct(
        counts,
        calibration,
        frames=frames,
        depth_range=depth_range,
        pileup_correction=pileup_correction,
        skips=skips,
        threads=threads,
    )
    return image, report
