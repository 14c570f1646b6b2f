# SPDX-License-Identifier: Apache-2.0
"""The published method: correlation with a reference, centroid, shifted window sums.

It is kept as published: equation (2) subtracts no background. It is the baseline that better
estimators are compared with. Two things are added. The loss of later photons of an exposure, which
makes bright pixels seem darker than they are, is undone unless asked otherwise. Pixels that show no
surface, or one at the end of the searched range, are flagged. Deviations contain the systematic
error of the correlation (`correlation_bias`). Where counts are whole numbers, `paper_kernel`
computes the same faster.
"""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from hueflight.calibration import Calibration, window_sums
from hueflight.fit.correlation import correlate, peak_centroid
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.reconstruction.correlation_bias import background_share, correlation_bias
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.options import EstimatorOptions
from hueflight.reconstruction.paper_kernel import Measured, Search, measure
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range, widened
from hueflight.reconstruction.return_test import without_return

#: options that change the result and that the method takes into account
honors = frozenset({"range_correction", "pileup_correction"})

END_BINS = 0.5  #: a delay so near the end of the searched range was cut off there
TILE_PIXELS = 512  #: pixels correlated at once: their spectra stay in the cache


def estimate(
    prepared: PreparedHistogram, calibration: Calibration, options: EstimatorOptions, /
) -> Estimates:
    """Estimate depth and reflectance of every pixel by the published method.

    With the pile-up correction, reflectance stays proportional to light at high occupancy. A sensor
    keeps one photon per exposure: the mean number that arrived is −ln(1 − hits/exposures).

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
        Results of all pixels.
    """
    light, known, frames = prepared.light, prepared.photons, prepared.exposures
    pileup_correction = options.pileup_correction
    rows, cols, count = light.shape
    usable = calibration.usable
    chosen = usable & (known > 0)
    delay_bins, delay_std = (np.full((rows, cols), np.nan) for _ in range(2))
    background = np.where(outside_windows(calibration).any(), np.zeros((rows, cols)), np.nan)
    sums = np.full((len(calibration.instrument.bands), rows, cols), np.nan)
    pixels = np.flatnonzero(known)
    rates = photons_per_period(known, frames, calibration.instrument) if pileup_correction else None
    if rates is not None:
        # hot pixels would have the whole picture corrected, which is slow
        rates = np.where(usable, rates, 0.0)
    light = coates_correction(light, rates)
    flat = light.reshape(rows * cols, count)
    measured = _measured(flat, pixels, known, calibration)
    kept = chosen.ravel()[pixels]
    delay_bins[chosen] = measured.delay[kept]
    share = background_share(
        flat, pixels[kept], measured.sums[kept], known.ravel()[pixels][kept], calibration
    )
    systematic = correlation_bias(measured.delay[kept], share, calibration, search_of(calibration))
    delay_std[chosen] = np.hypot(measured.deviation[kept], systematic)
    sums[:, chosen] = measured.sums[kept].T
    background.ravel()[pixels] = measured.background

    along_axis = calibration.bin_width_ns * calibration.meters_per_ns
    depth = calibration.distance + delay_bins * along_axis
    depth_std = delay_std * along_axis
    quality = np.zeros((rows, cols), np.uint16)
    quality[calibration.dead] |= int(Quality.DEAD)
    quality[calibration.hot] |= int(Quality.HOT)
    if frames is not None and pileup_correction:
        # every exposure held a photon: how many were lost can't be known
        quality[usable & (known >= frames)] |= int(Quality.SATURATED)
    # no better than a guess within the range searched: a uniform guess has range/√12
    search = search_bins(calibration)
    low_signal = usable & ~(depth_std < 2 * search * along_axis / np.sqrt(12))
    whole = np.rint(delay_bins[chosen] + calibration.pixel_delay[chosen]).astype(np.intp)
    absent = without_return(prepared, calibration, options, chosen, sums[:, chosen], whole)
    # a reference at the distance 0 does not tell where the camera is
    behind = (calibration.distance > 0) & (depth <= 0)
    outside = chosen & ((np.abs(delay_bins) >= search - END_BINS) | behind) & ~absent
    flags = {
        Quality.LOW_SIGNAL: low_signal,
        Quality.NO_RETURN: absent,
        Quality.OUT_OF_RANGE: outside,
    }
    for flag, flagged in flags.items():
        quality[flagged] |= int(flag)
    for plane in (depth, depth_std, *sums):
        plane[low_signal | absent | outside] = np.nan

    scale = calibration.photon_scale(known, frames, pileup_correction=pileup_correction)
    if options.range_correction:
        scale = scale * relative_range(depth, calibration) ** 2
    gain = calibration.gain[:, None, None] * scale
    reflectance = gain * sums
    # Poisson; one count at least, so that an empty window does not claim certainty
    reflectance_std = gain * np.sqrt(np.maximum(sums, 1))
    if options.range_correction:
        reflectance_std = widened(reflectance_std, reflectance, depth, depth_std)
    return Estimates(
        depth=depth,
        depth_std=depth_std,
        reflectance=reflectance,
        reflectance_std=reflectance_std,
        background=background,
        photons=known,
        quality=quality,
    )


def _measured(
    light: NDArray[Any],
    pixels: NDArray[np.int64],
    photons: NDArray[np.float64],
    calibration: Calibration,
) -> Measured:
    """Pixels of (pixel, bin) measured, compiled where that is possible."""
    most = float(photons.max(initial=0))
    outside = outside_windows(calibration)
    by_kernel = measure(light, pixels, most, calibration, search_of(calibration), outside)
    if by_kernel is not None:
        return by_kernel
    starts = range(0, max(len(pixels), 1), TILE_PIXELS)
    parts = [
        measured_numpy(light, pixels[start : start + TILE_PIXELS], calibration) for start in starts
    ]
    return Measured(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in Measured.__dataclass_fields__
        }
    )


def measured_numpy(
    light: NDArray[Any], pixels: NDArray[np.int64], calibration: Calibration
) -> Measured:
    """Measure delay, window sums and background of pixels: the NumPy definition.

    Parameters
    ----------
    light : ndarray, shape (pixel, bin)
        Counts in time order.
    pixels : ndarray of int64
        Pixels to measure.
    calibration : Calibration
        Calibration of the same instrument.

    Returns
    -------
    Measured
        Measurements of the chosen pixels.
    """
    tile = light[pixels].astype(np.float32, copy=False)
    reference = calibration.reference.reshape(light.shape)[pixels]
    delay, deviation = delays(tile, reference, calibration)
    sums = window_sums(
        tile,
        calibration.windows,
        np.rint(delay + calibration.pixel_delay.ravel()[pixels]).astype(np.intp),
        bands=len(calibration.instrument.bands),
        circular=calibration.bins.period_ns is not None,
    )
    return Measured(delay, deviation, sums.T, _background(tile, calibration))


def search_of(calibration: Calibration) -> Search:
    """Return the lags that are searched, and the window of the centroid.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    Search
        Lags in bins.
    """
    search = search_bins(calibration)
    half_width = min(calibration.half_width_bins, float(search))
    return Search(search, half_width, search + ceil(half_width))


def search_bins(calibration: Calibration) -> int:
    """Return the largest lag that is searched.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    int
        Half the spacing of the pulses or, without a period, three quarters of all bins.
    """
    bins = calibration.bins
    half_spacing_ns = calibration.instrument.half_spacing_ns()
    limit_ns = min(half_spacing_ns, bins.span_ns * 0.75)
    return max(1, int(limit_ns / calibration.bin_width_ns))


def delays(
    light: NDArray[np.floating], reference: NDArray[np.floating], calibration: Calibration
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the delay of each pixel against its own reference and its standard deviation.

    Parameters
    ----------
    light, reference : ndarray, shape (pixel, bin)
        Counts in time order.
    calibration : Calibration
        Calibration of the same instrument.

    Returns
    -------
    delay : ndarray of float, shape (pixel,)
        Delay in bins.
    deviation : ndarray of float, shape (pixel,)
        Its standard deviation in bins.
    """
    lags = search_of(calibration)
    search, half_width = lags.search, lags.half_width
    correlation = correlate(light, reference, lags.most)
    delay = peak_centroid(correlation, search=search, half_width=half_width)
    return delay, _centroid_deviation(light, reference, delay, correlation, search, half_width)


def _centroid_deviation(
    light: NDArray[np.floating],
    reference: NDArray[np.floating],
    delay: NDArray[np.float64],
    correlation: NDArray[np.floating],
    search: int,
    half_width: float,
) -> NDArray[np.float64]:
    """Standard deviation of the centroid by propagation of Poisson noise, in bins.

    The centroid is Σ_l l·C(l)/Σ_l C(l); one more photon in bin i moves it by
    g_i = Σ_l (l − τ)·r(i − l) / ΣC, so its variance is Σ_i g_i²·h_i; the reference's own noise
    adds likewise with the roles exchanged. Following the peak with the window makes the whole
    more sensitive by the share of light at the window's edges, which is accounted for.
    """
    reach = round(half_width)
    kernel = np.arange(-reach, reach + 1, dtype=np.float32)
    whole = np.rint(delay).astype(np.intp)
    aligned = _rolled(light, -whole)
    # scipy correlates: out_i = Σ_j kernel_j · in(i + j); hence the sign for r(i − l)
    influence_of_light = correlate1d(np.asarray(reference, np.float32), -kernel, mode="wrap")
    influence_of_reference = correlate1d(aligned, kernel, mode="wrap")
    scatter = np.einsum("pb,pb->p", influence_of_light**2, aligned) + np.einsum(
        "pb,pb->p", influence_of_reference**2, np.asarray(reference, np.float32)
    )
    middle = correlation.shape[-1] // 2
    pixels = np.arange(delay.size)
    pedestal = correlation[:, middle - search : middle + search + 1].min(axis=-1)
    at_edge = 0.5 * (
        correlation[pixels, middle + whole - reach] + correlation[pixels, middle + whole + reach]
    )
    inside = sum(correlation[pixels, middle + whole + lag] for lag in range(-reach, reach + 1))
    mass = inside - (2 * reach + 1) * pedestal
    gain = mass - 2 * half_width * np.maximum(at_edge - pedestal, 0)
    deviation = np.full(delay.shape, np.inf)
    np.divide(np.sqrt(scatter), gain, out=deviation, where=gain > 0)
    return deviation


def _rolled(light: NDArray[np.floating], shift: NDArray[np.intp]) -> NDArray[np.float32]:
    """Each pixel's bins moved later by its own whole number, around."""
    count = light.shape[-1]
    index = (np.arange(count) - shift[:, None]) % count
    return np.take_along_axis(np.asarray(light, np.float32), index, axis=-1)


def outside_windows(calibration: Calibration) -> NDArray[np.bool_]:
    """Return the bins of full width that belong to no window of the reference.

    Parameters
    ----------
    calibration : Calibration
        The calibration.

    Returns
    -------
    ndarray of bool, shape (bin,)
        True outside the windows.
    """
    count = calibration.bins.count
    outside = calibration.bins.widths_ns > 0.9 * calibration.bin_width_ns
    for window in calibration.windows:
        outside[np.arange(window.start, window.stop) % count] = False
    return outside


def _background(light: NDArray[np.floating], calibration: Calibration) -> NDArray[np.float64]:
    """Mean counts per code of the bins outside all windows, (pixel,); NaN if there are none.

    The windows are those of the reference, so the tails of a pixel much farther away count in.
    """
    outside = outside_windows(calibration)
    if not outside.any():
        return np.full(len(light), np.nan)
    return light[:, outside].mean(axis=-1, dtype=np.float64)
