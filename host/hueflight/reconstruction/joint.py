# SPDX-License-Identifier: Apache-2.0
"""Images by the joint maximum-likelihood fit, in metres and reflectance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.errors import HueflightError
from hueflight.fit.assessment import LARGEST_LOSS, MISFIT, p_value, wavelength_contrasts
from hueflight.fit.reference import Fit, no_fit
from hueflight.fit.smoothed_assessment import smoothed_misfit, smoothed_score
from hueflight.fit.solver import fit_pixels
from hueflight.fit.tables import (
    ModelTables,
    ScheduleView,
    detection_threshold,
    make_tables,
)
from hueflight.model.background_shape import FLAT, BackgroundShape
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.model.undersampling import smooth_undersampled
from hueflight.reconstruction.deviations import (
    add_pileup_noise,
    brightness_variance,
    common_misfit,
    delay_variance,
    is_piled_up,
    total_variance,
)
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.fitted_counts import FittedCounts
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.options import EstimatorOptions, Skips
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range, widened
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

BLIND = 0.7  #: of a uniform guess's deviation: who knows no better than this knows nothing
LIMIT_NS = 1e-3  #: a delay so near the end of the searched range was cut off there

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
        If the range is invalid, or wider than the depth after which the period repeats.
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
            f"period of {period_ns} ns repeats: narrow it"
        )
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
        calibration,
        search_ns=search_ns,
        range_correction=options.range_correction,
        pileup_correction=options.pileup_correction,
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
    pixels = np.flatnonzero(chosen)
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


def in_metres(
    found: Fit,
    chosen: NDArray[np.bool_],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    calibration: Calibration,
    *,
    search_ns: tuple[float, float],
    range_correction: bool,
    pileup_correction: bool,
    assessed: bool,
) -> Estimates:
    """Convert fitted pixels to estimates: depth, reflectance and flags.

    Parameters
    ----------
    found : Fit
        Fit of the chosen pixels, in order.
    chosen : ndarray of bool, shape (row, col)
        Pixels that were fitted.
    photons : ndarray of float, shape (row, col)
        Counts of each pixel.
    frames : ndarray of float, shape (row, col), or None
        Exposures behind them.
    calibration : Calibration
        Calibration of the same instrument.
    search_ns : tuple of float
        Delays that were searched.
    range_correction : bool
        Multiply reflectance by (distance / reference distance)².
    pileup_correction : bool
        Undo the loss of photons after the first one of an exposure.
    assessed : bool
        It was tested whether one surface explains the counts.

    Returns
    -------
    Estimates
        Results of all pixels.
    """
    rows, cols = photons.shape
    usable = calibration.usable
    everywhere = bool(chosen.all())
    blind_ns = BLIND * (search_ns[1] - search_ns[0]) / np.sqrt(12)
    low_signal = ~(found.delay_std_ns < blind_ns)
    no_return = found.detection < detection_threshold(search_ns)
    along_axis = SPEED_OF_LIGHT_M_PER_NS / 2 * calibration.instrument.ray_cosine()
    # with a reference at 0, as of a sensor with one of its own, depth has an offset
    has_target = calibration.distance > 0
    behind = has_target & (calibration.distance + found.delay_ns * along_axis[chosen] <= 0)
    low_ns, high_ns = search_ns[0] + LIMIT_NS, search_ns[1] - LIMIT_NS
    outside = (found.delay_ns <= low_ns) | (found.delay_ns >= high_ns) | behind
    unknown = low_signal | no_return | outside

    def plane(values: NDArray[np.float64], *, told: bool = True) -> NDArray[np.float64]:
        """As (…, row, col), but in memory as the fit gives it; NaN where nothing is told."""
        if told and unknown.any():
            values = values.copy()
            values[unknown] = np.nan
        if everywhere:
            filled = values.reshape(rows, cols, *values.shape[1:])
        else:
            filled = np.full((rows, cols, *values.shape[1:]), np.nan)
            filled[chosen] = values
        return np.moveaxis(filled, (0, 1), (-2, -1))

    misfit = common_misfit(found.chi_square[~unknown])
    variance_ns = delay_variance(
        found, chosen, calibration, misfit=misfit, least=detection_threshold(search_ns)
    )
    depth = calibration.distance + plane(found.delay_ns) * along_axis
    depth_std = plane(np.sqrt(variance_ns)) * along_axis
    other = calibration.distance + plane(found.other_ns) * along_axis

    flags = {
        Quality.LOW_SIGNAL: low_signal,
        Quality.NO_RETURN: no_return,
        Quality.OUT_OF_RANGE: outside & ~no_return,
        Quality.AMBIGUOUS_LAG: np.isfinite(found.other_ns) & ~unknown,
        Quality.MISFIT: (found.misfit > MISFIT) & ~unknown,
    }
    quality = _quality(calibration, chosen, flags)
    scale = calibration.photon_scale(photons, frames, pileup_correction=pileup_correction)
    quality[usable & is_piled_up(photons, frames, calibration.instrument)] |= int(Quality.PILED_UP)
    relative = brightness_variance(calibration)[chosen]
    if pileup_correction and frames is not None:
        quality[usable & (photons >= frames)] |= int(Quality.SATURATED)
        counted = (photons[chosen], frames[chosen], calibration.instrument)
        relative += total_variance(*counted)[:, None]
    if range_correction:
        guess = calibration.distance + plane(found.delay_ns, told=False) * along_axis
        scale = scale * relative_range(guess, calibration) ** 2
    gain = scale[chosen][:, None] / calibration.brightness
    deviation = np.sqrt(found.amplitude_std**2 * misfit + found.amplitudes**2 * relative)
    reflectance, reflectance_std = plane(gain * found.amplitudes), plane(gain * deviation)
    if range_correction:
        reflectance_std = widened(reflectance_std, reflectance, depth, depth_std)
    return Estimates(
        depth=depth,
        depth_std=depth_std,
        other_depth=other,
        reflectance=reflectance,
        reflectance_std=reflectance_std,
        background=plane(found.background, told=False)
        * calibration.bin_width_ns
        / calibration.bins.span_ns,
        photons=photons,
        quality=quality,
        white_photons=calibration.brightness.sum() / scale,
        fit_chi_square=plane(found.chi_square) if assessed else None,
        fit_p_value=plane(p_value(found.misfit)) if assessed else None,
    )


def _quality(
    calibration: Calibration,
    chosen: NDArray[np.bool_],
    flags: Mapping[Quality, NDArray[np.bool_]],
) -> NDArray[np.uint16]:
    """Return flags (row, col); `flags` are those of the chosen pixels (pixel,)."""
    quality = np.zeros(chosen.shape, np.uint16)
    quality[calibration.dead] |= int(Quality.DEAD)
    quality[calibration.hot] |= int(Quality.HOT)
    quality[calibration.usable & ~chosen] |= int(Quality.LOW_SIGNAL)
    of_chosen = np.zeros(int(chosen.sum()), np.uint16)
    for flag, pixels in flags.items():
        of_chosen[pixels] |= int(flag)
    quality[chosen] |= of_chosen
    return quality
