# SPDX-License-Identifier: Apache-2.0
"""From fits to results: depth in meters, reflectance, their deviations and flags.

The compiled conversion goes through the pixels once; see ``conversion.h`` of the kernels of the
fit. Its definition is `_put_defined`: results are the same to double precision, but reflectances
and deviations, for which some numbers are in single precision, to that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.fit.assessment import MISFIT, p_value
from hueflight.fit.reference import Fit
from hueflight.fit.solver import compiled_kernel
from hueflight.reconstruction import compiled_conversion
from hueflight.reconstruction.conversion_rules import UNTOLD, Conversion, base_flags
from hueflight.reconstruction.deviations import (
    brightness_variance,
    common_misfit,
    delay_variance,
    is_piled_up,
    total_variance,
)
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range
from hueflight.reconstruction.reflectances import LightScale, reflectances
from hueflight.reconstruction.result_planes import NUMBERS, ResultPlanes, empty_planes


def in_metres(
    found: Fit,
    chosen: NDArray[np.bool_],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    conversion: Conversion,
    *,
    assessed: bool,
) -> Estimates:
    """Convert the fitted pixels of a picture to estimates.

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
    conversion : Conversion
        How fits become results.
    assessed : bool
        It was tested whether one surface explains the counts.

    Returns
    -------
    Estimates
        Results of all pixels.
    """
    planes = empty_planes(photons.shape, conversion.calibration.brightness.size)
    everywhere = np.ones(photons.shape, bool)
    put_results(planes, found, everywhere, chosen, photons, frames, conversion)
    return planes.estimates(assessed=assessed)


def put_results(
    planes: ResultPlanes,
    found: Fit,
    changed: NDArray[np.bool_],
    chosen: NDArray[np.bool_],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    conversion: Conversion,
) -> None:
    """Put results of some pixels in a picture; the others stay as they are.

    Parameters
    ----------
    planes : ResultPlanes
        The picture, which is changed.
    found : Fit
        Fit of the chosen pixels, in order.
    changed : ndarray of bool, shape (row, col)
        Pixels whose results are put.
    chosen : ndarray of bool, shape (row, col)
        Those of them that were fitted; the others get none.
    photons : ndarray of float, shape (row, col)
        Counts of each pixel.
    frames : ndarray of float, shape (row, col), or None
        Exposures behind them.
    conversion : Conversion
        How fits become results.
    """
    kernel = compiled_kernel(conversion.calibration.brightness.size)
    put = _put_defined if kernel is None else compiled_conversion.put
    put(planes, found, changed, chosen, photons, frames, conversion)


def verdicts(
    found: Fit, along_axis: NDArray[np.float64], conversion: Conversion
) -> NDArray[np.uint16]:
    """Return flags of fits: why their depth is not told, or what else is wrong.

    Parameters
    ----------
    found : Fit
        The fits.
    along_axis : ndarray of float, shape (pixel,)
        Depth along the optical axis per delay, m/ns.
    conversion : Conversion
        How fits become results.

    Returns
    -------
    ndarray of uint16, shape (pixel,)
        Bits of `Quality`.
    """
    low_signal = ~(found.delay_std_ns < conversion.blind_ns)
    no_return = found.detection < conversion.least_detection
    # with a reference at 0, as of a sensor with one of its own, depth has an offset
    distance = conversion.calibration.distance
    behind = (distance > 0) & (distance + found.delay_ns * along_axis <= 0)
    low_ns, high_ns = conversion.limits_ns
    outside = (found.delay_ns <= low_ns) | (found.delay_ns >= high_ns) | behind
    told = ~(low_signal | no_return | outside)
    flags = np.zeros(told.size, np.uint16)
    for flag, pixels in {
        Quality.LOW_SIGNAL: low_signal,
        Quality.NO_RETURN: no_return,
        Quality.OUT_OF_RANGE: outside & ~no_return,
        Quality.AMBIGUOUS_LAG: np.isfinite(found.other_ns) & told,
        Quality.MISFIT: (found.misfit > MISFIT) & told,
    }.items():
        flags[pixels] |= int(flag)
    return flags


def _put_defined(
    planes: ResultPlanes,
    found: Fit,
    changed: NDArray[np.bool_],
    chosen: NDArray[np.bool_],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    conversion: Conversion,
) -> None:
    calibration = conversion.calibration
    along_axis = calibration.meters_per_ns[chosen]
    flags = verdicts(found, along_axis, conversion)
    told = flags & int(UNTOLD) == 0

    def plane(values: NDArray[Any]) -> NDArray[Any]:
        """Values (pixel, …) of the chosen pixels as (row, col, …), the others NaN."""
        filled = np.full((*chosen.shape, *values.shape[1:]), np.nan, values.dtype)
        filled[chosen] = values
        return filled

    def told_plane(values: NDArray[Any]) -> NDArray[Any]:
        """The same, also NaN where nothing is told."""
        values = values.copy()
        values[~told] = np.nan
        return plane(values)

    misfit = common_misfit(found.chi_square[told])
    variance_ns = delay_variance(
        found, chosen, calibration, misfit=misfit, least=conversion.least_detection
    )
    guess = calibration.distance + found.delay_ns * along_axis
    depth_std = np.sqrt(variance_ns) * along_axis
    scale = calibration.photon_scale(
        photons, frames, pileup_correction=conversion.pileup_correction
    )
    by_pixel, by_band = brightness_variance(calibration)
    shared = by_pixel[chosen]
    if conversion.pileup_correction and frames is not None:
        shared = shared + total_variance(photons[chosen], frames[chosen], calibration.instrument)
    by_range = np.zeros(guess.size)
    if conversion.range_correction:
        scale = scale * relative_range(plane(guess), calibration) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):  # no depth, no reflectance
            by_range = 2 * depth_std / np.abs(guess)
    light = LightScale(scale[chosen], shared, by_range, calibration.brightness, by_band, misfit)
    per_code = calibration.bin_width_ns / calibration.bins.span_ns
    results = {
        "depth": told_plane(guess),
        "depth_std": told_plane(depth_std),
        "other_depth": told_plane(calibration.distance + found.other_ns * along_axis),
        "background": plane(found.background) * per_code,
        "photons": photons,
        "white_photons": calibration.brightness.sum() / scale,
        "fit_chi_square": told_plane(found.chi_square),
        "fit_p_value": told_plane(p_value(found.misfit)),
    }
    for number, name in enumerate(NUMBERS):
        planes.numbers[number][changed] = results[name][changed]
    for number, values in enumerate(reflectances(found, light)):
        planes.reflectances[number][changed] = told_plane(values)[changed]
    planes.quality[changed] = _quality(chosen, flags, photons, frames, conversion)[changed]


def _quality(
    chosen: NDArray[np.bool_],
    flags: NDArray[np.uint16],
    photons: NDArray[np.float64],
    frames: NDArray[np.float64] | None,
    conversion: Conversion,
) -> NDArray[np.uint16]:
    """Flags (row, col), of which `flags` are those of the fits."""
    calibration = conversion.calibration
    usable = calibration.usable
    quality = base_flags(calibration)
    quality[usable & ~chosen] |= int(Quality.LOW_SIGNAL)
    quality[chosen] |= flags
    quality[usable & is_piled_up(photons, frames, calibration.instrument)] |= int(Quality.PILED_UP)
    if conversion.pileup_correction and frames is not None:
        quality[usable & (photons >= frames)] |= int(Quality.SATURATED)
    return quality
