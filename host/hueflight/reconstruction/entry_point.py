# SPDX-License-Identifier: Apache-2.0
"""The entry points of reconstruction: a histogram or packets in, an image out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from hueflight.arguments import (
    COUNTS,
    NUMBERS,
    PACKETS,
    POSITIVE,
    RANGE,
    SWITCH,
    TEXT,
    WHOLE,
    Kind,
    listed,
    takes,
)
from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.ingest import IngestReport, accumulate
from hueflight.ingest.accumulator import Counts
from hueflight.ingest.kernels import Buffer
from hueflight.memory import require_memory, within_memory
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.histograms import as_native
from hueflight.reconstruction import joint
from hueflight.reconstruction.departures import find_background
from hueflight.reconstruction.image import as_image
from hueflight.reconstruction.inputs import PreparedHistogram, prepare_histogram
from hueflight.reconstruction.methods import METHODS, Estimator, check_options, find_method
from hueflight.reconstruction.options import (
    DEFAULT_SKIPS,
    EstimatorOptions,
    Region,
    Skips,
    band_numbers,
    leave_out,
    region_mask,
)
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import resolve
from hueflight.reconstruction.sampled_pixels import MOST_PIXELS, state_background, trusted
from hueflight.reconstruction.separation import lens_angle
from hueflight.reconstruction.stored_counts import (
    BLOCK_BYTES,
    StoredArray,
    StoredCounts,
    is_stored,
)

__all__ = ["METHODS", "reconstruct", "reconstruct_packets"]

BYTES_PER_PIXEL = 250  #: of memory that the results of a pixel take on their way, measured,
BYTES_PER_BAND = 100  #: and of each of its bands
FEWER_PIXELS = (
    "Reconstruct with method='joint', which reads counts on disk in blocks, or a part of the "
    "sensor that is described as an instrument of its own"
)


#: what `bands` may be
BANDS = listed(
    Kind("a band", lambda value: isinstance(value, str) or WHOLE.accepts(value)),
    "a list of names or whole numbers of bands",
)


@within_memory("the reconstruction", advice=FEWER_PIXELS)
@takes(
    histogram=COUNTS,
    calibration=Calibration,
    method=TEXT,
    depth_range=RANGE,
    frames=NUMBERS,
    range_correction=SWITCH,
    pileup_correction=SWITCH,
    bands=BANDS,
    skips=Skips,
    threads=POSITIVE,
    mixed=SWITCH,
    second_returns=SWITCH,
)
def reconstruct(
    histogram: ArrayLike | StoredArray,
    calibration: Calibration,
    /,
    *,
    method: str = "joint",
    depth_range: tuple[float, float] | None = None,
    frames: ArrayLike | None = None,
    range_correction: bool | None = None,
    pileup_correction: bool = True,
    background: BackgroundShape | Literal["flat", "sloped"] = "flat",
    bands: Sequence[str | int] | None = None,
    region: Region | None = None,
    skips: Skips = DEFAULT_SKIPS,
    threads: int = 1,
    mixed: bool | None = None,
    second_returns: bool | None = None,
) -> xr.Dataset:
    """Reconstruct depth and reflectance in every band from one histogram per pixel.

    Parameters
    ----------
    histogram : array_like, shape (row, col, code)
        Counts, raw codes on the last axis. Arrays of Zarr, HDF5 or dask and memory-mapped files
        stay on disk: ``"joint"`` reads them twice, in blocks of rows.
    calibration : Calibration
        Calibration of the same instrument.
    method : str
        A key of `METHODS`: ``"joint"`` is the maximum likelihood of delay, amplitude of every band
        and background together; ``"pooled"`` is for few photons, where neighboring pixels lend
        theirs; ``"sums"`` rests on the few sums that a camera can make of each pixel's codes, see
        `reconstruct_sums`; ``"paper"`` is the published correlation method.
    depth_range : tuple of float, optional
        Nearest and farthest depth to search, m; by default half the spacing of the pulses about
        the distance of the reference. ``"paper"`` does not take it.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the histogram; by default the sum over codes where the sensor reports its
        empty exposures, else as many as the reference had. ``image.attrs["exposures"]`` says
        whether the number is known.
    range_correction : bool, optional
        Multiply reflectance by the squared ratio of the distance to that of the reference, so that
        it does not depend on the distance. By default wherever the calibration knows the distance
        of the reference. ``image.reflectance.attrs["range_correction"]`` says which was done.
    pileup_correction : bool
        Undo the loss of later photons of an exposure, where the sensor reports its empty exposures
        or `frames` says how many there were.
    background : BackgroundShape or {"flat", "sloped"}
        How the background is distributed over the time bins. ``"sloped"`` finds a slope or a slow
        decay that all pixels share, from their residuals, before all pixels are fitted with it;
        the attributes of ``image.background`` say what was found. ``"joint"`` only.
    bands : sequence of str or int, optional
        Names, numbers or wavelengths (``"532 nm"``) of the bands whose reflectance is wanted, by
        default all. All bands are fitted in any case, because depth rests on the light of every
        band.
    region : tuple of two slices, or array of bool with shape (row, col), optional
        Rows and columns, such as ``np.s_[10:20, 30:40]``, or a mask. Pixels outside have no result
        and are flagged skipped. Only ``"joint"`` saves time by it.
    skips : Skips
        What ``"joint"`` may leave out.
    threads : int
        Threads that share the pixels; ``"paper"`` uses one.
    mixed : bool, optional
        Find the pixels at edges that see two surfaces, and give them the depths of both. By
        default wherever the method is ``"joint"`` and the instrument has a lens, which tells the
        angle between pixels.
    second_returns : bool, optional
        Fit two surfaces to pixels whose counts show more than one, as behind glass. By default
        wherever the method is ``"joint"``, except for what a departure from the calibration
        explains that the rest of the picture shows as well; True takes all of it for surfaces, as
        where the whole picture lies behind a pane.

    Returns
    -------
    Dataset
        Variables `depth`, `depth_std` (m), `reflectance`, `reflectance_std`, `background` (counts
        per code), `photons` and `quality`; what can't be known is NaN and flagged. Method
        ``"pooled"`` adds `resolution`, the width in pixels of what an estimate rests on. Where
        mixed pixels or second returns were looked for, there are `second_depth`,
        `near_reflectance` and `second_reflectance`, with their deviations, and for mixed pixels
        `near_share`.

    Raises
    ------
    HistogramError
        If the histogram does not fit the calibration's instrument or is empty, or if there is no
        such method, region or band.
    MemoryLimitError
        If the work would take more memory than `hueflight.memory.limit_bytes`.
    HueflightError
        If the method can't take an option into account, or range correction is asked for and the
        distance of the reference is not known, or mixed pixels are asked for and the instrument
        has no lens.
    """
    estimator = find_method(method)
    given = _in_memory_or_stored(histogram, calibration, estimator)
    prepared = prepare_histogram(given, calibration, frames)
    wanted = region_mask(region, calibration.instrument.image_shape)
    numbers = band_numbers(bands, calibration)
    corrected = resolve(range_correction, calibration, honors=estimator.honors)
    if not isinstance(background, BackgroundShape) and background not in ("flat", "sloped"):
        raise HueflightError(
            f"background = {background!r}: choose 'flat' or 'sloped', or give a BackgroundShape"
        )
    options = EstimatorOptions(
        depth_range=depth_range,
        range_correction=corrected,
        pileup_correction=pileup_correction,
        background=FLAT if background == "flat" else background,
        region=wanted,
        skips=skips,
        threads=threads,
        mixed=_finds_mixed(mixed, calibration, honors=estimator.honors),
        second_returns=_second_returns(second_returns, honors=estimator.honors),
    )
    check_options(method, estimator, options)
    if options.background == "sloped":
        shape = _background_of(prepared, calibration, options, wanted)
        options = replace(options, background=shape)
    estimates = estimator.estimate(prepared, calibration, options)
    estimates.quality[prepared.full] |= int(Quality.SATURATED)
    leave_out(estimates, ~wanted)
    image = as_image(
        estimates,
        calibration,
        method=method,
        range_correction=corrected,
        exposures_known=frames is not None or calibration.instrument.sensor.reports_empty,
    )
    if isinstance(options.background, BackgroundShape):
        state_background(image, options.background)
    return image if bands is None else image.isel(band=numbers)


def _background_of(
    prepared: PreparedHistogram,
    calibration: Calibration,
    options: EstimatorOptions,
    wanted: NDArray[np.bool_],
) -> BackgroundShape:
    """Shape of the background, from some of the pixels that are asked for."""
    numbers = np.flatnonzero(wanted & calibration.usable)
    some = np.zeros(wanted.shape, bool)
    some.flat[numbers[:: max(1, numbers.size // MOST_PIXELS)]] = True
    plain = replace(options, background=FLAT, region=some, mixed=False, second_returns=False)
    flat = joint.estimate(prepared, calibration, plain)
    return find_background(
        prepared,
        calibration,
        trusted(flat.depth, flat.quality) & some,
        depth_range=options.depth_range,
        pileup_correction=options.pileup_correction,
        threads=options.threads,
    )


def _second_returns(wanted: bool | None, *, honors: frozenset[str]) -> bool | Literal["auto"]:
    """Decide whether second returns are looked for."""
    if wanted is None:
        return "auto" if "second_returns" in honors else False
    return wanted


def _finds_mixed(wanted: bool | None, calibration: Calibration, *, honors: frozenset[str]) -> bool:
    """Decide whether mixed pixels are looked for."""
    if wanted:
        lens_angle(calibration.instrument)  # says so where there is no lens
    if wanted is None:
        return "mixed" in honors and calibration.instrument.lens is not None
    return wanted


def _in_memory_or_stored(
    histogram: ArrayLike | StoredArray, calibration: Calibration, method: Estimator
) -> ArrayLike | StoredCounts:
    """Counts on disk as the method reads them, after a check of the memory that this takes."""
    instrument = calibration.instrument
    pixels, bands = int(np.prod(instrument.image_shape)), len(instrument.bands)
    needed = pixels * (BYTES_PER_PIXEL + BYTES_PER_BAND * bands)
    stored = None
    if is_stored(histogram):
        stored = StoredCounts(histogram, calibration.bins)
        if getattr(method, "reads_stored", False):
            needed += 3 * BLOCK_BYTES
        else:
            needed += float(np.prod(histogram.shape)) * (stored.dtype.itemsize + 4)
    require_memory(
        needed,
        f"the reconstruction of {pixels} pixels with {bands} bands",
        advice=FEWER_PIXELS,
    )
    if stored is None or getattr(method, "reads_stored", False):
        return histogram if stored is None else stored  # pyright: ignore[reportReturnType]
    return as_native(stored.source[:])


@within_memory("the reconstruction", advice=FEWER_PIXELS)
@takes(
    packets=PACKETS,
    calibration=Calibration,
    depth_range=RANGE,
    range_correction=SWITCH,
    pileup_correction=SWITCH,
    skips=Skips,
    threads=POSITIVE,
    mixed=SWITCH,
    second_returns=SWITCH,
)
def reconstruct_packets(
    packets: Buffer,
    calibration: Calibration,
    /,
    *,
    out: Counts | None = None,
    depth_range: tuple[float, float] | None = None,
    range_correction: bool | None = None,
    pileup_correction: bool = True,
    skips: Skips = DEFAULT_SKIPS,
    threads: int = 1,
    mixed: bool | None = None,
    second_returns: bool | None = None,
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
    range_correction : bool, optional
        Correct reflectance for the distance; see `reconstruct`.
    pileup_correction : bool
        Undo the loss of later photons of an exposure.
    skips : Skips
        What the fit may leave out.
    threads : int
        Threads that share the pixels, first of counting, then of fitting.
    mixed : bool, optional
        Find the pixels at edges that see two surfaces; see `reconstruct`.
    second_returns : bool, optional
        Fit two surfaces where one does not explain the counts; see `reconstruct`.

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
    image = reconstruct(
        counts,
        calibration,
        depth_range=depth_range,
        range_correction=range_correction,
        pileup_correction=pileup_correction,
        skips=skips,
        threads=threads,
        mixed=mixed,
        second_returns=second_returns,
    )
    return image, report
