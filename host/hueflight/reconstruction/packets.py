"""Packets to an image in one call: counted and fitted where the counts lie, on the same threads."""

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
    """Depth and reflectance in every band from a stream of packets, by the joint fit.

    Parameters
    ----------
    packets : whole packets of frames; damage is skipped and reported.
    calibration : of the same instrument.
    out : (row, col, code) counts to use as working memory: emptied first, then filled. Pictures
        in sequence save the time of new memory by it.
    depth_range, pileup_correction, skips : as in `reconstruct`.
    threads : over pixels, first of counting, then of fitting.

    Returns
    -------
    The image, and the report of what came.

    Raises
    ------
    IngestError
        If frames are of another geometry than the instrument's.
    HistogramError
        If no frame came, or `out` does not fit the instrument.
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
