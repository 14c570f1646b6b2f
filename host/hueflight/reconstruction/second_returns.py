# SPDX-License-Identifier: Apache-2.0
"""Pixels that see two surfaces by their own counts: glass, mesh, foliage.

Two surfaces are fitted (`hueflight.fit.two_returns`) where one does not explain the counts, but not
in a single pixel whose test fails by chance. Where they are found, the pixels in a region of those
that fail are tried as well, since panes are larger than a pixel, and those around two surfaces are
asked whether they see the same two (`pairs_around`). Both depths are reported if two
surfaces are far more likely than one and their delays are told apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from hueflight.calibration import Calibration
from hueflight.fit.assessment import MISFIT, gamma_score, p_value
from hueflight.fit.two_returns import (
    TwoReturns,
    fit_two_returns,
    one_surface_likelihood,
)
from hueflight.reconstruction.deviations import brightness_variance, common_misfit
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.fitted_counts import FittedCounts
from hueflight.reconstruction.fitted_picture import FittedPicture
from hueflight.reconstruction.pairs_around import with_neighbors
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range, widened
from hueflight.reconstruction.shared_scores import FittedPixels, explained_by
from hueflight.reconstruction.told_apart import divided, told_apart

LEAST_GAIN = 30.0  #: twice the log-likelihood ratio: fewer than 1 in 1000 of one surface exceed it
CERTAIN_MISFIT = 5.0  #: score from which a pixel is tried although no neighbor fails
REACH = 2  #: rows and columns to either side within which pixels that fail are counted
MANY_AROUND = 2  #: that fail around it, and a pixel that passes may be tried
#: share of the amplitudes beyond that from which pulses of both surfaces coincide, and the factor
#: on the deviations of both depths then: amplitudes that can't be negative leave no parabola
COINCIDENT, COINCIDENT_FACTOR = 0.5, 1.5
SAMPLE = 256  #: pixels that tell whether it is worth the time to try all others,
WORTHWHILE = 0.02  #: which it is if this share of them sees two surfaces
#: flags of one surface that no longer apply
REPLACED = Quality.AMBIGUOUS_LAG | Quality.MISFIT | Quality.OUT_OF_RANGE

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]


def with_second_returns(
    estimates: Estimates, fitted: FittedCounts, calibration: Calibration, *, everywhere: bool
) -> Estimates:
    """Find pixels whose counts show two surfaces, and give them the depths of both.

    Parameters
    ----------
    estimates : Estimates
        Result of the joint fit with its assessment; mixed pixels, if looked for, have been found.
    fitted : FittedCounts
        Counts that it was made from.
    calibration : Calibration
        Calibration of the same instrument.
    everywhere : bool
        Take all that one surface does not explain for surfaces, also what other pixels of the
        picture show as well.

    Returns
    -------
    Estimates
        The same with `Quality.TWO_RETURNS`. `depth` of such a pixel is that of the near surface,
        `second_depth` that of the far one.
    """
    tables = fitted.tables
    estimates = with_room(estimates)
    if not tables.resolved or estimates.fit_p_value is None:
        return estimates
    unexplained, beside = pixels_to_try(estimates)
    if not unexplained.any():
        return estimates
    estimates = _copied(estimates)
    picture = FittedPicture(estimates, fitted, calibration)
    numbers = np.flatnonzero(unexplained)
    sample = numbers[:: 1 if everywhere else max(1, numbers.size // SAMPLE)]
    first = _tried(sample, picture)
    misfit = common_misfit(first.fit.chi_square)  # what two surfaces do not explain either
    if not (first.gain > LEAST_GAIN * misfit).any():
        return estimates
    wanted = unexplained | beside
    common = None if everywhere else picture.common_departures(wanted)
    kept = first.beyond(common, picture) > LEAST_GAIN * misfit
    numbers, found = sample[kept], first.fit.take(kept)
    rest = np.setdiff1d(np.flatnonzero(wanted), sample)
    if rest.size and kept.mean() >= WORTHWHILE:
        others = _tried(rest, picture)
        more = others.beyond(common, picture) > LEAST_GAIN * misfit
        numbers = np.concatenate([numbers, rest[more]])
        found = TwoReturns.joined([found, others.fit.take(more)])
    numbers, found = with_neighbors(numbers, found, single_surfaces(estimates), picture)
    _put(estimates, numbers, found, fitted, calibration, misfit)
    return estimates


def pixels_to_try(estimates: Estimates) -> tuple[_Mask, _Mask]:
    """Return the pixels in which one surface may not be all, and those around them.

    Parameters
    ----------
    estimates : Estimates
        Result of the joint fit with its assessment.

    Returns
    -------
    unexplained : ndarray of bool, shape (row, col)
        Pixels that fail the test for one surface by far, and those that fail it within two rows
        and columns of another one; never mixed pixels.
    beside : ndarray of bool, shape (row, col)
        Other pixels within two rows and columns of at least two that fail. By chance, a clean
        picture has some, so that they are worth the time only where two surfaces were found.
    """
    free = single_surfaces(estimates)
    failing = free & ((estimates.quality & int(Quality.MISFIT)) != 0)
    if not failing.any():
        return failing, failing
    around = _failing_around(failing)
    assert estimates.fit_p_value is not None
    certain = failing & (estimates.fit_p_value < p_value(np.array(CERTAIN_MISFIT)))
    unexplained = certain | (failing & (around > 0))
    return unexplained, free & (around >= MANY_AROUND) & ~unexplained


def single_surfaces(estimates: Estimates) -> _Mask:
    """Return the pixels to which one surface was fitted, so that they may see two.

    Parameters
    ----------
    estimates : Estimates
        Result of the joint fit with its assessment.

    Returns
    -------
    ndarray of bool, shape (row, col)
        Pixels that show light, without mixed pixels.
    """
    quality = estimates.quality
    known = np.isfinite(estimates.depth) | (
        (quality & int(Quality.OUT_OF_RANGE | Quality.SKIPPED)) == int(Quality.OUT_OF_RANGE)
    )
    return known & ((quality & int(Quality.MIXED)) == 0)


def _failing_around(failing: _Mask) -> NDArray[np.int8]:
    """Number of failing pixels around each pixel."""
    padded = np.pad(failing, REACH)
    rows, cols = failing.shape
    count = np.zeros(failing.shape, np.int8)
    for row in range(2 * REACH + 1):
        for col in range(2 * REACH + 1):
            count += padded[row : row + rows, col : col + cols]
    return count - failing


@dataclass(frozen=True)
class _Tried:
    """Fits of one and of two surfaces to pixels, and twice the gain in log-likelihood of two.

    The gain is 0 where the two are not told apart, or one lies at the end of the searched range.
    """

    fit: TwoReturns
    one: FittedPixels
    gain: _Floats

    def beyond(self, common: _Floats | None, picture: FittedPicture) -> _Floats:
        """Gain without what departures explain that other pixels show as well."""
        if common is None:
            return self.gain
        explained = explained_by(self.one, picture.model(), common)
        return self.gain - np.maximum(explained, 0.0)


def _tried(numbers: NDArray[np.intp], picture: FittedPicture) -> _Tried:
    """Fit two surfaces to some pixels."""
    tables, light = picture.fitted.tables, picture.light(numbers)
    one = picture.pixels(numbers, light)
    found = fit_two_returns(light, one.offset_ns, tables, picture.calibration.brightness)
    likelihood = one_surface_likelihood(
        light, one.arrival_ns, one.amplitudes, one.background, tables
    )
    distinct = told_apart(found, tables)
    return _Tried(found, one, np.where(distinct, 2 * (found.log_likelihood - likelihood), 0.0))


def with_room(estimates: Estimates) -> Estimates:
    """Return estimates with the variables of pixels that see two surfaces.

    Parameters
    ----------
    estimates : Estimates
        Estimates with or without them.

    Returns
    -------
    Estimates
        The same; variables that were missing are NaN.
    """
    shape, cube = estimates.depth.shape, estimates.reflectance.shape
    added: dict[str, Any] = {}
    for surface in ("near", "second"):
        for name in (f"{surface}_reflectance", f"{surface}_reflectance_std"):
            if getattr(estimates, name) is None:
                added[name] = np.full(cube, np.nan, np.float32)
    for name in ("second_depth", "second_depth_std"):
        if getattr(estimates, name) is None:
            added[name] = np.full(shape, np.nan)
    return replace(estimates, **added)


def _copied(estimates: Estimates) -> Estimates:
    """Return estimates whose arrays may be changed."""
    arrays = {name: getattr(estimates, name) for name in Estimates.__dataclass_fields__}
    copies: dict[str, Any] = {
        name: values.copy() for name, values in arrays.items() if values is not None
    }
    return replace(estimates, **copies)


def _put(
    estimates: Estimates,
    numbers: NDArray[np.intp],
    found: TwoReturns,
    fitted: FittedCounts,
    calibration: Calibration,
    misfit: float,
) -> None:
    """Replace the results of pixels by those of two surfaces, in place."""
    here = np.unravel_index(numbers, estimates.depth.shape)
    along_axis = calibration.meters_per_ns[here]
    variance = found.delay_std_ns**2 * misfit + calibration.pixel_delay_std_ns[here][:, None] ** 2
    if calibration.waveform_delay_std_ns is not None:
        variance = variance + found.influence**2 @ calibration.waveform_delay_std_ns**2
    depth = calibration.distance + found.delay_ns * along_axis[:, None]
    depth_std = np.sqrt(variance) * along_axis[:, None]
    unknown = ~divided(found)
    depth_std[unknown.mean(axis=(1, 2)) >= COINCIDENT] *= COINCIDENT_FACTOR
    white = fitted.white_photons(numbers, calibration)[:, None]
    by_pixel, by_band = brightness_variance(calibration)
    relative = by_pixel[here][:, None, None] + by_band
    reflectance = found.amplitudes / white
    noise = found.amplitude_std**2 * misfit
    deviation = np.sqrt(noise + found.amplitudes**2 * relative) / white
    corrected = np.ones_like(depth)
    if fitted.range_correction:
        corrected = relative_range(depth, calibration) ** 2
        reflectance, deviation = (
            values * corrected[..., None] for values in (reflectance, deviation)
        )
        deviation = widened(deviation, reflectance, depth[..., None], depth_std[..., None])
    reflectance[unknown] = deviation[unknown] = np.nan
    assert estimates.white_photons is not None
    assert estimates.fit_chi_square is not None
    assert estimates.fit_p_value is not None
    score = gamma_score(found.chi_square, found.chi_square_shape)
    explained = score <= MISFIT
    planes = {
        "depth": depth[:, 0],
        "depth_std": depth_std[:, 0],
        "second_depth": depth[:, 1],
        "second_depth_std": depth_std[:, 1],
        "background": found.background * calibration.bin_width_ns / calibration.bins.span_ns,
        "white_photons": white.sum(axis=(1, 2)) / corrected[:, 0],
        "fit_chi_square": found.chi_square,
        "fit_p_value": np.exp(log_ndtr(-score)),
        "other_depth": np.full(numbers.size, np.nan),
    }
    for number, surface in enumerate(("near", "second")):
        planes[f"{surface}_reflectance"] = reflectance[:, number].T
        planes[f"{surface}_reflectance_std"] = deviation[:, number].T
    planes["reflectance"] = planes["near_reflectance"]
    planes["reflectance_std"] = planes["near_reflectance_std"]
    for name, values in planes.items():
        getattr(estimates, name)[..., *here] = values
    flags = estimates.quality[here] & ~np.uint16(REPLACED)
    flags[~explained] |= np.uint16(Quality.MISFIT)
    estimates.quality[here] = flags | np.uint16(Quality.TWO_RETURNS)
