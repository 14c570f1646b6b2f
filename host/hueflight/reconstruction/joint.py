# SPDX-License-Identifier: Apache-2.0
"""Images by the joint maximum-likelihood fit, in metres and reflectance."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.fit.assessment import LARGEST_LOSS, wavelength_contrasts
from hueflight.fit.reference import Fit, no_fit
from hueflight.fit.smoothed_assessment import smoothed_misfit, smoothed_score
from hueflight.fit.solver import fit_pixels, pixel_numbers
from hueflight.fit.tables import (
    ModelTables,
    ScheduleView,
    make_tables,
)
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.model.undersampling import smooth_undersampled
from hueflight.reconstruction.conversion import in_metres
from hueflight.reconstruction.conversion_rules import Conversion
from hueflight.reconstruction.deviations import (
    add_pileup_noise,
    common_misfit,
)
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.fitted_counts import FittedCounts
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.options import EstimatorOptions, Skips
from hueflight.reconstruction.second_returns import with_second_returns
from hueflight.reconstruction.separation import with_both_depths
from hueflight.reconstruction.stored_counts import StoredCounts

reads_stored = True  #: counts that stay on disk are read in blocks
#: options that change the result and that the method takes into account
honors = frozenset(
    {
        "depth_range",
        "range_correction",
        "pileup_correction",
        "background",
        "mixed",
        "second_returns",
    }
)

_Key = tuple[tuple[float, float], BackgroundShape]
_kept_tables: WeakKeyDictionary[Calibration, dict[_Key, ModelTables]] = WeakKeyDictionary()


def tables_for_calibration(
    calibration: Calibration,
    search_ns: tuple[float, float],
    background: BackgroundShape = FLAT,
) -> ModelTables:
    """Return the tables for a calibration, which are kept as long as it lives.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    search_ns : tuple of float
        Least and greatest delay against the reference.
    background : BackgroundShape
        How the background is distributed over the bins.

    Returns
    -------
    ModelTables
        Tables of the fit.
    """
    kept = _kept_tables.setdefault(calibration, {})
    key = search_ns, background
    if key not in kept:
        delays_ns = calibration.pixel_delay_ns[calibration.usable]
        instrument = calibration.instrument
        kept[key] = make_tables(
            [ScheduleView(calibration.bins, calibration.templates, background=background)],
            shortest_fwhm_ns=min(band.pulse_fwhm_ns for band in instrument.bands),
            brightness=calibration.brightness,
            search_ns=search_ns,
            offsets_ns=(float(delays_ns.min()), float(delays_ns.max())),
            contrasts=wavelength_contrasts(instrument.wavelengths_nm),
        )
    return kept[key]


def resolved_background(options: EstimatorOptions) -> BackgroundShape:
    """Return the shape of the background, which must be known.

    Parameters
    ----------
    options : EstimatorOptions
        What was asked for.

    Returns
    -------
    BackgroundShape
        The shape.

    Raises
    ------
    HueflightError
        If it is still to be found, which `reconstruct` does.
    """
    if not isinstance(options.background, BackgroundShape):
        raise HueflightError(
            f"background = {options.background!r}: give the shape itself, or use reconstruct"
        )
    return options.background


def search_range_ns(
    calibration: Calibration, depth_range: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the least and the greatest delay to search, against the reference.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    depth_range : tuple of float, or None
        Nearest and farthest depth, m. None for half the spacing of the pulses either way, or three
        quarters of a single shot.

    Returns
    -------
    tuple of float
        Least and greatest delay, ns.

    Raises
    ------
    HueflightError
        If the range is invalid, wider than the depth after which the period repeats, or nowhere
        that a single shot records.
    """
    if depth_range is None:
        limit_ns = min(calibration.instrument.half_spacing_ns(), 0.75 * calibration.bins.span_ns)
        return -limit_ns, limit_ns
    near, far = depth_range
    if not (isfinite(near) and isfinite(far) and near < far):
        raise HueflightError(
            f"depth_range = {depth_range!r}: give the nearest and the farthest depth in metres"
        )
    slowest = 1 / calibration.instrument.ray_cosine().min()  # the range of the outermost ray
    low, high = (
        2 * (depth - calibration.distance) / SPEED_OF_LIGHT_M_PER_NS for depth in depth_range
    )
    low, high = min(low, low * slowest), max(high, high * slowest)
    period_ns = calibration.bins.period_ns
    if period_ns is not None and high - low > period_ns:
        reach = period_ns * SPEED_OF_LIGHT_M_PER_NS / 2
        raise HueflightError(
            f"depth_range = {depth_range!r} spans more than the {reach:.1f} m after which the "
            f"period of {period_ns} ns repeats: narrow it, and give it in meters"
        )
    if period_ns is None:  # beyond, the pulses of a single shot lie outside its bins
        span_ns = calibration.bins.span_ns
        if low >= span_ns or high <= -span_ns:
            reach = span_ns * SPEED_OF_LIGHT_M_PER_NS / 2
            raise HueflightError(
                f"depth_range = {depth_range!r}: light from there arrives outside the {span_ns:g} "
                f"ns that are recorded; depths lie within {reach:.1f} m of the reference, which "
                f"was at {calibration.distance:g} m: give the range in meters"
            )
        low, high = max(low, -span_ns), min(high, span_ns)
    return low, high


def estimate(
    prepared: PreparedHistogram, calibration: Calibration, options: EstimatorOptions, /
) -> Estimates:
    """Estimate depth and reflectance of every pixel by the joint fit.

    Parameters
    ----------
    prepared : PreparedHistogram
        The histogram, checked and in time order.
    calibration : Calibration
        Calibration of the same instrument.
    options : EstimatorOptions
        What was asked for.

    Returns
    -------
    Estimates
        Results of the pixels of the region that was asked for.
    """
    light, photons, exposures = prepared.light, prepared.photons, prepared.exposures
    skips, usable = options.skips, calibration.usable
    search_ns = search_range_ns(calibration, options.depth_range)
    wanted = np.ones(photons.shape, bool) if options.region is None else options.region
    chosen = wanted.copy()
    if skips.empty:
        chosen &= photons > 0
    if skips.defects:
        chosen &= usable
    tables = tables_for_calibration(calibration, search_ns, resolved_background(options))
    frames = exposures if options.pileup_correction else None
    found = fit_chosen(
        light.reshape(-1, light.shape[-1]),
        chosen,
        photons,
        frames,
        calibration,
        tables,
        skips=skips,
        threads=options.threads,
    )
    known = wanted & usable & (photons > 0)
    estimates = in_metres(
        found if np.array_equal(known, chosen) else found.take(known[chosen]),
        known,
        photons,
        exposures,
        Conversion(calibration, search_ns, options.range_correction, options.pileup_correction),
        assessed=skips.of_fit(calibration).assessment,
    )
    if not (options.mixed or options.second_returns):
        return estimates
    scale = calibration.photon_scale(
        photons, exposures, pileup_correction=options.pileup_correction
    )
    white = calibration.brightness.sum() / scale
    counts = FittedCounts(light, frames, white, tables, options.range_correction)
    if options.mixed:
        estimates = with_both_depths(estimates, counts, calibration)
    if options.second_returns:
        everywhere = options.second_returns is True
        estimates = with_second_returns(estimates, counts, calibration, everywhere=everywhere)
    return estimates


def fit_chosen(
    light: NDArray[Any] | StoredCounts,
    chosen: NDArray[np.bool_],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    calibration: Calibration,
    tables: ModelTables,
    *,
    skips: Skips,
    threads: int,
) -> Fit:
    """Fit some of the pixels, in order.

    Parameters
    ----------
    light : ndarray, shape (row · col, bin), or StoredCounts
        Counts in time order; those on disk are read in blocks of rows.
    chosen : ndarray of bool, shape (row, col)
        Pixels to fit.
    photons : ndarray of float, shape (row, col)
        Sums of `light`.
    frames : ndarray of float, shape (row, col), or None
        Exposures; None to leave the loss of later photons of an exposure as it is.
    calibration : Calibration
        Calibration of the same instrument.
    tables : ModelTables
        Tables of the fit.
    skips : Skips
        What may be left out.
    threads : int
        Threads that share the pixels.

    Returns
    -------
    Fit
        Result of the chosen pixels.
    """
    pixels = pixel_numbers(chosen)
    delays_ns = calibration.pixel_delay_ns[chosen]
    rates = None
    if frames is not None:
        rates = photons_per_period(photons[chosen], frames[chosen], calibration.instrument)
    if not isinstance(light, StoredCounts):
        return _fit_block(light, pixels, delays_ns, rates, calibration, tables, skips, threads)
    found = no_fit(pixels.size, tables.bands)
    for some, counts, here in light.pixels(pixels):
        part = None if rates is None else rates[some]
        common = calibration, tables, skips, threads
        found.put(some, _fit_block(counts, here, delays_ns[some], part, *common))
    return found


def _fit_block(
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    delays_ns: NDArray[np.float64],
    rates: NDArray[np.float64] | None,
    calibration: Calibration,
    tables: ModelTables,
    skips: Skips,
    threads: int,
) -> Fit:
    instrument = calibration.instrument
    switches = skips.of_fit(calibration)
    if tables.resolved:
        options = {"pixels": pixels, "per_period": rates, "threads": threads}
        found = fit_pixels(light, delays_ns, tables, switches, **options)
    else:
        seen = smooth_undersampled(
            coates_correction(light[pixels], rates), instrument, calibration.bins
        )
        # smoothed counts do not scatter as Poisson counts
        plain = replace(switches, assessment=False)
        found = fit_pixels(seen, delays_ns, tables, plain, threads=threads)
        if switches.assessment:
            assess_smoothed(found, seen, delays_ns, tables)
    if rates is not None and float(np.max(rates, initial=0.0)) > LARGEST_LOSS:
        add_pileup_noise(found, light[pixels], delays_ns, rates, tables)
    return found


def assess_smoothed(
    found: Fit, seen: NDArray[Any], delays_ns: NDArray[np.float64], tables: ModelTables
) -> None:
    """Test whether one surface explains counts that were smoothed; see `smoothed_misfit`.

    Parameters
    ----------
    found : Fit
        Fit, whose test results are filled in.
    seen : ndarray, shape (pixel, bin)
        Smoothed counts.
    delays_ns : ndarray of float, shape (pixel,)
        Delay that belongs to the pixel itself, ns.
    tables : ModelTables
        Tables of the fit.
    """
    misfit, freedom = smoothed_misfit(
        seen, found.delay_ns + delays_ns, found.amplitudes, found.background, tables
    )
    found.chi_square[:] = misfit
    found.misfit[:] = smoothed_score(misfit, freedom, common_misfit(misfit))
