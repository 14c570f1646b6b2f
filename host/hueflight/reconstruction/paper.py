"""The paper's method: correlation with a reference, centroid, shifted window sums.

Kept as published: equation (2) subtracts no background. It is the baseline that better
estimators are measured against. Only the loss of later photons of an exposure, which makes
bright pixels seem darker than they are, is undone unless asked otherwise.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from hueflight.calibration import Calibration, window_sums
from hueflight.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.correlation import correlate, peak_centroid
from hueflight.reconstruction.image import Estimates
from hueflight.reconstruction.pileup import lost_photons_factor
from hueflight.reconstruction.quality import Quality

TILE_PIXELS = 512  #: pixels correlated at once: their spectra stay in the cache


def estimate(
    light: NDArray[np.floating],
    frames: NDArray[np.float64] | None,
    calibration: Calibration,
    *,
    range_correction: bool = False,
    pileup_correction: bool = True,
) -> Estimates:
    """Depth and reflectance of every pixel by the paper's method.

    Parameters
    ----------
    light : (row, col, bin) counts in time order.
    frames : (row, col) exposures behind them, or None to assume as many as the reference had.
    range_correction : multiply reflectance by (distance / reference distance)².
    pileup_correction : undo the loss of later photons of an exposure, so that reflectance
        stays proportional to light at high occupancy (a sensor keeps one photon per exposure:
        the mean number that arrived is −ln(1 − hits/frames)).
    """
    rows, cols, _ = light.shape
    usable = calibration.usable
    delay_bins = np.full((rows, cols), np.nan)
    delay_std = np.full((rows, cols), np.nan)
    sums = np.full((len(calibration.instrument.bands), rows, cols), np.nan)
    chosen = np.argwhere(usable & (light.any(axis=-1)))
    for start in range(0, len(chosen), TILE_PIXELS):
        row, col = chosen[start : start + TILE_PIXELS].T
        tile = light[row, col]
        delay_bins[row, col], delay_std[row, col] = delays(
            tile, calibration.reference[row, col], calibration
        )
        shift = np.rint(delay_bins[row, col] + calibration.pixel_delay[row, col]).astype(np.intp)
        sums[:, row, col] = window_sums(
            tile,
            calibration.windows,
            shift,
            bands=sums.shape[0],
            circular=calibration.bins.period_ns is not None,
        )

    metres_per_bin = calibration.bin_width_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    along_axis = metres_per_bin * calibration.instrument.ray_cosine()
    depth = calibration.distance + delay_bins * along_axis
    depth_std = delay_std * along_axis
    photons = light.sum(axis=-1, dtype=np.float64)

    quality = np.zeros((rows, cols), np.uint16)
    quality[calibration.dead] |= int(Quality.DEAD)
    quality[calibration.hot] |= int(Quality.HOT)
    if frames is not None and pileup_correction:
        # every exposure held a photon: how many were lost can't be known
        quality[usable & (photons >= frames)] |= int(Quality.SATURATED)
    # no better than a guess within the range searched: a uniform guess has range/√12
    blind = 2 * search_bins(calibration) * along_axis / np.sqrt(12)
    starved = usable & ~(depth_std < blind)
    quality[starved] |= int(Quality.STARVED)
    for plane in (depth, depth_std, *sums):
        plane[starved] = np.nan

    scale = _reflectance_scale(photons, frames, calibration, pileup_correction=pileup_correction)
    if range_correction:
        scale = scale * np.square(_range_ratio(depth, calibration))
    gain = calibration.gain[:, None, None] * scale
    return Estimates(
        depth=depth,
        depth_std=depth_std,
        reflectance=gain * sums,
        # Poisson; one count at least, so that an empty window does not claim certainty
        reflectance_std=gain * np.sqrt(np.maximum(sums, 1)),
        background=_background(light, calibration),
        photons=photons,
        quality=quality,
    )


def search_bins(calibration: Calibration) -> int:
    """Largest lag that is searched: half the pulse spacing, else all the codes there are."""
    bins = calibration.bins
    half_spacing_ns = calibration.instrument.half_spacing_ns()
    limit_ns = min(half_spacing_ns, bins.span_ns * 0.75)
    return max(1, int(limit_ns / calibration.bin_width_ns))


def delays(
    light: NDArray[np.floating], reference: NDArray[np.floating], calibration: Calibration
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Delay of each pixel against its own reference and its standard deviation, in bins.

    Parameters
    ----------
    light, reference : (pixel, bin) counts in time order.
    """
    search = search_bins(calibration)
    half_width = min(calibration.half_width_bins, float(search))
    correlation = correlate(light, reference, search + ceil(half_width))
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


def _reflectance_scale(
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    calibration: Calibration,
    *,
    pileup_correction: bool,
) -> NDArray[np.float64]:
    """Factor (row, col) from window sums to reflectance, but for each band's gain."""
    flat_field = calibration.flat_field
    if frames is None or calibration.frames is None:
        return 1 / flat_field
    photons_of = photons
    frames_of = frames
    if not pileup_correction:  # the calibration is in photons that arrived: take the loss back
        photons_of = calibration.reference.sum(axis=-1, dtype=np.float64)
        frames_of = calibration.frames
    return lost_photons_factor(photons_of, frames_of) / (flat_field * frames)


def _range_ratio(depth: NDArray[np.float64], calibration: Calibration) -> NDArray[np.float64]:
    """Distance over reference distance; the angle of the ray cancels."""
    return depth / calibration.distance if calibration.distance > 0 else np.full_like(depth, np.nan)


def _background(light: NDArray[np.floating], calibration: Calibration) -> NDArray[np.float64]:
    """Mean counts per code of the bins outside all windows, (row, col); NaN if there are none.

    The windows are those of the reference, so the tails of a pixel much farther away count in.
    """
    count = calibration.bins.count
    outside = np.ones(count, dtype=bool)
    for window in calibration.windows:
        outside[np.arange(window.start, window.stop) % count] = False
    outside &= calibration.bins.widths_ns > 0.9 * calibration.bin_width_ns
    if not outside.any():
        return np.full(light.shape[:2], np.nan)
    return light[..., outside].mean(axis=-1, dtype=np.float64)
