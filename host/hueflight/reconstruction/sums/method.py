# SPDX-License-Identifier: Apache-2.0
"""Images from sums, in metres and reflectance."""

from __future__ import annotations

from functools import cache
from math import ceil, log2
from weakref import WeakKeyDictionary

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

from hueflight.arguments import COUNTS, NUMBERS, SWITCH, takes
from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.fit.assessment import misfit_score
from hueflight.fit.reference import Fit
from hueflight.fit.tables import FALSE_ALARM_RATE, detection_threshold
from hueflight.model.histograms import frames_per_pixel
from hueflight.model.pileup import NEGLIGIBLE, photons_per_period
from hueflight.reconstruction.conversion import in_metres
from hueflight.reconstruction.conversion_rules import LIMIT_NS, Conversion
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.image import as_image
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.options import EstimatorOptions, Region, leave_out, region_mask
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import resolve
from hueflight.reconstruction.sums.delay_tables import (
    SumTables,
    code_offsets,
    offset_delay_ns,
    sum_tables,
)
from hueflight.reconstruction.sums.design import SumsDesign, design_sums
from hueflight.reconstruction.sums.estimator import SumsFit
from hueflight.reconstruction.sums.kernels import estimate_pixels
from hueflight_protocol.reduction import check_offsets, reduce_histogram

#: options that change the result and that the method takes into account
honors = frozenset({"depth_range", "range_correction", "pileup_correction"})

CERTAIN = 150.0  #: a squared distance from background alone that chance never reaches
LEAST_CAPACITY = 2048.0  #: photons that sums of a histogram hold at least
ROOT_STEP, MOST_ROOT = 0.01, 45.0  #: of χ, in tables: scores beyond are the greatest that there is

_Key = tuple[tuple[float, float] | None, float]
_designs: WeakKeyDictionary[Calibration, dict[_Key, SumsDesign]] = WeakKeyDictionary()


def estimate(
    prepared: PreparedHistogram, calibration: Calibration, options: EstimatorOptions, /
) -> Estimates:
    """Estimate depth and reflectance of every pixel from the sums that its histogram gives.

    Parameters
    ----------
    prepared : PreparedHistogram
        The histogram, checked and in time order.
    calibration : Calibration
        Calibration of the same instrument.
    options : EstimatorOptions
        What was asked for. The tables are designed for the depth range.

    Returns
    -------
    Estimates
        Results.

    Raises
    ------
    HistogramError
        If counts are not whole numbers.
    """
    counts = prepared.counts
    if counts.dtype.kind not in "iu" and not np.array_equal(counts, np.rint(counts)):
        raise HistogramError(
            f"the histogram holds counts of type {counts.dtype} that are not whole: a camera sums "
            "whole photons; use method='joint'"
        )
    design = _design_for(calibration, options.depth_range, float(prepared.photons.max()))
    offsets = code_offsets(calibration)
    sums = reduce_histogram(
        counts.reshape(-1, counts.shape[-1]), design.tables, offsets=offsets.ravel()
    )
    return estimate_sums(
        sums.reshape(*offsets.shape, -1),
        design,
        calibration,
        offsets,
        exposures=prepared.exposures,
        range_correction=options.range_correction,
        pileup_correction=options.pileup_correction,
    )


def _design_for(
    calibration: Calibration, depth_range: tuple[float, float] | None, photons: float
) -> SumsDesign:
    """Design whose sums hold so many photons; it is kept as long as the calibration lives."""
    most = max(LEAST_CAPACITY, 2.0 ** ceil(log2(max(photons, 1.0))))
    kept = _designs.setdefault(calibration, {})
    if (depth_range, most) not in kept:
        kept[depth_range, most] = design_sums(
            calibration, depth_range=depth_range, most_photons=most
        )
    return kept[depth_range, most]


@takes(
    sums=COUNTS,
    design=SumsDesign,
    calibration=Calibration,
    offsets=NUMBERS,
    frames=NUMBERS,
    range_correction=SWITCH,
    pileup_correction=SWITCH,
)
def reconstruct_sums(
    sums: ArrayLike,
    design: SumsDesign,
    calibration: Calibration,
    /,
    *,
    offsets: ArrayLike | None = None,
    frames: ArrayLike | None = None,
    range_correction: bool | None = None,
    pileup_correction: bool = True,
    region: Region | None = None,
) -> xr.Dataset:
    """Reconstruct depth and reflectance in every band from a few sums per pixel.

    Parameters
    ----------
    sums : array_like of int, shape (row, col, sum)
        Sums of the reduction, the first of which is the number of photons. One at the greatest
        value that its width allows is saturated.
    design : SumsDesign
        The tables that the sums were made with.
    calibration : Calibration
        Calibration of the same instrument.
    offsets : array_like of int, shape (row, col), optional
        Offset of each pixel in the tables, codes; by default none. See `code_offsets`.
    frames : array_like, shape (row, col), or float, optional
        Exposures behind the sums; by default as many as the reference had.
    range_correction : bool, optional
        Multiply reflectance by the squared ratio of the distance to that of the reference; by
        default wherever the calibration knows that.
    pileup_correction : bool
        Undo the loss of later photons of an exposure, where `frames` says how many there were.
    region : tuple of two slices, or array of bool with shape (row, col), optional
        Rows and columns, or a mask. Pixels outside have no result and are flagged skipped.

    Returns
    -------
    Dataset
        Image as `hueflight.reconstruct` gives it.

    Raises
    ------
    HistogramError
        If the sums do not have the shape of the image and the design, or `frames` is not finite
        and above 0.
    HueflightError
        If an offset is out of range.
    """
    rows, cols = calibration.instrument.image_shape
    values = np.asarray(sums)
    expected = (rows, cols, design.tables.sums)
    if values.shape != expected or values.dtype.kind not in "iu":
        raise HistogramError(
            f"sums have shape {values.shape} and type {values.dtype}: must be whole numbers of "
            f"shape {expected}"
        )
    each = check_offsets(offsets, design.tables, rows * cols).reshape(rows, cols)
    exposures = calibration.frames
    if frames is not None:
        exposures = frames_per_pixel(values, calibration.instrument, frames)
    wanted = region_mask(region, (rows, cols))
    corrected = resolve(range_correction, calibration, honors=honors)
    estimates = estimate_sums(
        values,
        design,
        calibration,
        each,
        exposures=exposures,
        range_correction=corrected,
        pileup_correction=pileup_correction and frames is not None,
    )
    leave_out(estimates, ~wanted)
    return as_image(
        estimates,
        calibration,
        method="sums",
        range_correction=corrected,
        exposures_known=frames is not None,
    )


def estimate_sums(
    sums: NDArray[np.unsignedinteger],
    design: SumsDesign,
    calibration: Calibration,
    offsets: NDArray[np.intp],
    *,
    exposures: NDArray[np.float64] | None,
    range_correction: bool,
    pileup_correction: bool,
) -> Estimates:
    """Estimate depth and reflectance of every pixel from sums.

    Parameters
    ----------
    sums : ndarray of int, shape (row, col, sum)
        Sums, the first of which is the number of photons.
    design : SumsDesign
        The tables that they were made with.
    calibration : Calibration
        Calibration of the same instrument.
    offsets : ndarray of int, shape (row, col)
        Offset of each pixel, codes.
    exposures : ndarray of float, shape (row, col), or None
        Exposures behind the sums.
    range_correction, pileup_correction : bool
        See `reconstruct_sums`.

    Returns
    -------
    Estimates
        Results; pixels with a saturated sum have none and are flagged.

    Raises
    ------
    HueflightError
        If the first table does not count photons.
    """
    if design.tables.entries[0].max() != 1:
        raise HueflightError(
            "the first table of the design must count photons: make it with design_sums"
        )
    reached = sums.max(axis=(0, 1)) == design.tables.limits  # most often by no pixel
    saturated = (sums[..., reached] == design.tables.limits[reached]).any(axis=-1)
    photons = sums[..., 0].astype(np.float64)
    chosen = (photons > 0) & ~saturated & calibration.usable
    tables = sum_tables(calibration, design, offsets)
    if chosen.all():  # a copy takes as long as a tenth of the estimate
        seen, moved = sums.reshape(-1, sums.shape[-1]), offsets.ravel()
    else:
        seen, moved = sums[chosen], offsets[chosen]
    found = estimate_pixels(seen, tables.number_of(moved), tables)
    if pileup_correction and exposures is not None:
        rates = photons_per_period(photons[chosen], exposures[chosen], calibration.instrument)
        if rates is not None:
            _undo_shadows(found, rates, calibration)
    search_ns = _search_range_ns(calibration, design, tables)
    moved_ns = design.middle_ns + offset_delay_ns(calibration, moved)
    estimates = in_metres(
        _as_fit(found, moved_ns, calibration.pixel_delay_ns[chosen], tables, search_ns),
        chosen,
        photons,
        exposures,
        Conversion(calibration, search_ns, range_correction, pileup_correction),
        assessed=tables.sums > tables.bands + 2,
    )
    estimates.quality[saturated] &= ~np.uint16(Quality.LOW_SIGNAL)
    estimates.quality[saturated] |= int(Quality.SATURATED)
    return estimates


def _search_range_ns(
    calibration: Calibration, design: SumsDesign, tables: SumTables
) -> tuple[float, float]:
    """Least and greatest delay against the reference that any pixel was searched for."""
    moved_ns = offset_delay_ns(calibration, tables.offsets) + design.middle_ns
    delays_ns = calibration.pixel_delay_ns[calibration.usable]
    low_ns = float(moved_ns.min() - delays_ns.max()) + tables.first_ns
    return low_ns, float(moved_ns.max() - delays_ns.min()) + tables.last_ns


def _as_fit(
    found: SumsFit,
    moved_ns: NDArray[np.floating],
    pixel_delay_ns: NDArray[np.floating],
    tables: SumTables,
    search_ns: tuple[float, float],
) -> Fit:
    """Result of the estimator as that of a fit to histograms, against the reference."""
    low_ns, high_ns = tables.first_ns + LIMIT_NS, tables.last_ns - LIMIT_NS
    cut_off = (found.delay_ns <= low_ns) | (found.delay_ns >= high_ns)
    delay_ns = np.where(cut_off, search_ns[0], found.delay_ns + moved_ns - pixel_delay_ns)
    chi_square, misfit = _assessed(found.distance, tables.sums - tables.bands - 2)
    return Fit(
        delay_ns=delay_ns,
        delay_std_ns=found.delay_std_ns,
        other_ns=np.full(delay_ns.size, np.nan),
        amplitudes=found.amplitudes,
        amplitude_std=found.amplitude_std,
        background=found.background,
        detection=_detection(found.dark_distance, tables.sums - 1, search_ns),
        chi_square=chi_square,
        misfit=misfit,
        steps=np.ones(delay_ns.size, np.uint8),
    )


def _detection(
    distance: NDArray[np.float64], freedom: int, search_ns: tuple[float, float]
) -> NDArray[np.float64]:
    """Detection ratio that background alone reaches as often as it reaches this distance."""
    ratio = np.full(distance.shape, np.nan)
    near = distance < CERTAIN
    rate = np.maximum(_exceeded(distance[near], freedom), 1e-300)
    ratio[near] = detection_threshold(search_ns) + 2 * np.log(FALSE_ALARM_RATE / rate)
    return ratio


def _exceeded(distance: NDArray[np.float64], freedom: int) -> NDArray[np.float64]:
    """Probability that χ² exceeds a value."""
    if freedom % 2:
        return chdtrc(freedom, distance)
    # a sum of Poisson's probabilities, which is faster
    half = np.minimum(distance / 2, 700.0)
    term = total = np.exp(-half)
    for number in range(1, freedom // 2):
        term = term * half / number
        total = total + term
    return total


def _assessed(
    distance: NDArray[np.float64], freedom: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """χ² per degree of freedom, and its score as the greatest of as many tests as a fit has."""
    if freedom < 1:
        nothing = np.full(distance.shape, np.nan)
        return nothing, nothing
    scores = _scores(freedom)
    place = np.minimum(np.sqrt(distance) / ROOT_STEP, scores.size - 1.001)
    below = place.astype(np.intp)
    low = scores[below]
    return distance / freedom, low + (place - below) * (scores[below + 1] - low)


@cache
def _scores(freedom: int) -> NDArray[np.float64]:
    """Score of every ROOT_STEP of the root of χ²."""
    roots = np.arange(0.0, MOST_ROOT, ROOT_STEP)
    return misfit_score(_exceeded(roots**2, freedom))


def _undo_shadows(found: SumsFit, rates: NDArray[np.float64], calibration: Calibration) -> None:
    """Scale each band to what arrived: photons of a period hide those that come later in it.

    A photon is recorded if none came before it in its period, which has the probability
    exp(−r·F), with r photons per period of which the share F comes earlier (Coates, J. Phys. E 1,
    878, 1968). F is taken at the middle of each band's light.
    """
    if float(np.max(rates, initial=0.0)) < NEGLIGIBLE:
        return
    bins = calibration.bins
    shares = calibration.templates.shares(bins.edges_ns)
    before = np.cumsum(shares, axis=1) - shares / 2
    order = before @ shares.T  # (band, band): share of a band before the middle of another
    dark = shares @ ((bins.centers_ns - bins.edges_ns[0]) / bins.span_ns)
    light = np.maximum(found.amplitudes, 0.0)
    background = np.maximum(found.background, 0.0)
    total = np.maximum(light.sum(axis=1) + background, 1e-300)
    earlier = (light @ order + background[:, None] * dark) / total[:, None]
    factor = np.exp(np.asarray(rates)[:, None] * (earlier - 0.5))
    found.amplitudes[:] *= factor
    found.amplitude_std[:] *= factor
