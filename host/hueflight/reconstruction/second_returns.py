# SPDX-License-Identifier: Apache-2.0
"""Pixels that see two surfaces by their own counts: glass, mesh, foliage.

Two surfaces are fitted (`hueflight.fit.two_returns`) where one does not explain the counts. A
pixel in a region of such pixels is tried as well, since panes are larger than a pixel, whereas a
single pixel whose test fails by chance is not. Both depths are reported if two surfaces are far
more likely than one and their delays are told apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from hueflight.calibration import Calibration
from hueflight.fit.assessment import MISFIT, gamma_score, p_value
from hueflight.fit.tables import ModelTables
from hueflight.fit.two_returns import (
    TwoReturns,
    best_single,
    fit_two_returns,
    one_surface_likelihood,
)
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.deviations import brightness_variance, common_misfit
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.fitted_counts import FittedCounts, arrival_ns
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range
from hueflight.reconstruction.shared_scores import (
    FittedPixels,
    SharedModel,
    explained_by,
    sum_scores,
)

LEAST_GAIN = 30.0  #: twice the log-likelihood ratio: fewer than 1 in 1000 of one surface exceed it
CERTAIN_MISFIT = 5.0  #: score from which a pixel is tried although no neighbor fails
MANY_NEIGHBORS = 2  #: that fail, next to which a pixel is tried although it passes
APART = 2.0  #: standard deviations of the distance between the surfaces, at least
LARGEST_INFLATION = 9.0  #: of an amplitude's variance by the other surface's pulses
SAMPLE = 256  #: pixels that tell whether it is worth the time to try all others,
WORTHWHILE = 0.02  #: which it is if this share of them sees two surfaces
MOST_OTHERS = 512  #: pixels that tell what departs in the whole picture
FEWEST_OTHERS, LEAST_OTHERS = 30, 0.1  #: pixels, and share of all, that have to be left for that
TAILS_NS = (3.0, 15.0)  #: mean delays of exponential tails that are looked for
TYPICAL_DELAY_NS, TYPICAL_WIDTH, TYPICAL_TAIL = 0.3, 0.1, 0.3  #: sizes of departures
#: flags of one surface that no longer apply
REPLACED = Quality.AMBIGUOUS_LAG | Quality.MISFIT | Quality.OUT_OF_RANGE
LIMIT_NS = 1e-3  #: a delay so near the end of the searched range was cut off there

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
    if not tables.resolved or estimates.fit_p_value is None:
        return with_room(estimates)
    wanted = pixels_to_try(estimates)
    if not wanted.any():
        return with_room(estimates)
    estimates = _copied(with_room(estimates))
    data = _Data(estimates, fitted, calibration)
    numbers = np.flatnonzero(wanted)
    sample = numbers[:: 1 if everywhere else max(1, numbers.size // SAMPLE)]
    first = _tried(sample, data)
    misfit = common_misfit(first.fit.chi_square)  # what two surfaces do not explain either
    if not (first.gain > LEAST_GAIN * misfit).any():
        return estimates
    common = None if everywhere else data.common_departures(wanted)
    kept = first.beyond(common, data) > LEAST_GAIN * misfit
    rest = np.setdiff1d(numbers, sample)
    if rest.size and kept.mean() >= WORTHWHILE:
        others = _tried(rest, data)
        more = others.beyond(common, data) > LEAST_GAIN * misfit
        _put(estimates, rest[more], others.fit.take(more), fitted, calibration, misfit)
    _put(estimates, sample[kept], first.fit.take(kept), fitted, calibration, misfit)
    return estimates


def pixels_to_try(estimates: Estimates) -> _Mask:
    """Return the pixels in which one surface may not be all.

    Parameters
    ----------
    estimates : Estimates
        Result of the joint fit with its assessment.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True for pixels that fail the test for one surface by far, for those that fail it next to
        another one, and for those between at least two that fail; never for mixed pixels.
    """
    quality = estimates.quality
    known = np.isfinite(estimates.depth) | (
        (quality & int(Quality.OUT_OF_RANGE | Quality.SKIPPED)) == int(Quality.OUT_OF_RANGE)
    )
    free = known & ((quality & int(Quality.MIXED)) == 0)
    failing = free & ((quality & int(Quality.MISFIT)) != 0)
    if not failing.any():
        return failing
    padded = np.pad(failing, 1)
    rows, cols = failing.shape
    beside = np.zeros(failing.shape, np.int8)
    for row in range(3):
        for col in range(3):
            beside += padded[row : row + rows, col : col + cols]
    beside -= failing
    assert estimates.fit_p_value is not None
    certain = failing & (estimates.fit_p_value < p_value(np.array(CERTAIN_MISFIT)))
    return certain | (failing & (beside > 0)) | (free & (beside >= MANY_NEIGHBORS))


@dataclass(frozen=True)
class _Data:
    """Estimates, and the counts that they were made from."""

    estimates: Estimates
    fitted: FittedCounts
    calibration: Calibration

    def light(self, numbers: NDArray[np.intp]) -> _Floats:
        """Counts (pixel, bin) of pixels."""
        return self.fitted.of(numbers, self.estimates.photons, self.calibration)

    def pixels(self, numbers: NDArray[np.intp], light: _Floats) -> FittedPixels:
        """Fit of one surface to pixels: from the estimates, where these state a depth."""
        tables, calibration = self.fitted.tables, self.calibration
        depth = self.estimates.depth.ravel()[numbers]
        signal = self.estimates.reflectance.reshape(tables.bands, -1)[:, numbers].T
        if self.fitted.range_correction:
            signal = signal / relative_range(depth, calibration)[:, None] ** 2
        white = self.fitted.white_photons(numbers, calibration)
        background = self.estimates.background.ravel()[numbers]
        arrivals, amplitudes = arrival_ns(depth, numbers, calibration), signal * white
        unknown = ~np.isfinite(depth)
        if unknown.any():
            best = best_single(light[unknown], tables, calibration.brightness)
            arrivals[unknown], amplitudes[unknown] = best
        return FittedPixels(
            counts=tables.search.summed(tables.fine.summed(light)),
            arrival_ns=arrivals,
            offset_ns=calibration.pixel_delay_ns.ravel()[numbers],
            amplitudes=np.maximum(amplitudes, 0.0),
            background=background * calibration.bins.span_ns / calibration.bin_width_ns,
        )

    def model(self) -> SharedModel:
        """Departures that the pixels of a picture may share."""
        tables, calibration = self.fitted.tables, self.calibration
        edges_ns = calibration.bins.edges_ns[np.append(tables.fine.starts, -1)]
        if tables.wide is not tables.fine:
            edges_ns = edges_ns[np.append(tables.wide.starts, -1)]
        return SharedModel(
            edges_ns=edges_ns,
            templates=calibration.templates,
            background=tables.views[0].background,
            step_ns=tables.fine.phase_ns,
            tails_ns=TAILS_NS,
            decays_ns=(),
            flares_ns=(),
        )

    def common_departures(self, wanted: _Mask) -> _Floats:
        """Sizes of the departures that the other pixels show, or all where few are left."""
        flags = int(Quality.MIXED | Quality.MISFIT)
        known = np.isfinite(self.estimates.depth)
        others = known & ~wanted & ((self.estimates.quality & flags) == 0)
        if others.sum() < max(FEWEST_OTHERS, LEAST_OTHERS * known.sum()):
            others = known & ((self.estimates.quality & int(Quality.MIXED)) == 0)
        numbers = np.flatnonzero(others)
        numbers = numbers[:: max(1, numbers.size // MOST_OTHERS)]
        model = self.model()
        summed = sum_scores(self.pixels(numbers, self.light(numbers)), model)
        bands = self.fitted.tables.bands
        typical = np.repeat(
            [TYPICAL_DELAY_NS, TYPICAL_WIDTH, 1.0, TYPICAL_TAIL], [bands, bands, 1, len(TAILS_NS)]
        )
        scaled = summed.information * np.outer(typical, typical) + np.eye(typical.size)
        return np.asarray(typical * np.linalg.solve(scaled, typical * summed.score), np.float64)


@dataclass(frozen=True)
class _Tried:
    """Fits of one and of two surfaces to pixels, and twice the gain in log-likelihood of two.

    The gain is 0 where the two are not told apart, or one lies at the end of the searched range.
    """

    fit: TwoReturns
    one: FittedPixels
    gain: _Floats

    def beyond(self, common: _Floats | None, data: _Data) -> _Floats:
        """Gain without what departures explain that other pixels show as well."""
        if common is None:
            return self.gain
        return self.gain - explained_by(self.one, data.model(), common)


def _tried(numbers: NDArray[np.intp], data: _Data) -> _Tried:
    """Fit two surfaces to some pixels."""
    tables, light = data.fitted.tables, data.light(numbers)
    one = data.pixels(numbers, light)
    found = fit_two_returns(light, one.offset_ns, tables, data.calibration.brightness)
    likelihood = one_surface_likelihood(
        light, one.arrival_ns, one.amplitudes, one.background, tables
    )
    apart = np.diff(found.delay_ns, axis=1)[:, 0]
    noise = np.sqrt((found.delay_std_ns**2).sum(axis=1))
    low, high = tables.search_ns
    inside = (found.delay_ns > low + LIMIT_NS) & (found.delay_ns < high - LIMIT_NS)
    bin_ns = np.diff(tables.search.lags_ns).mean() if tables.search.lags_ns.size > 1 else 0.0
    distinct = (
        (apart > np.maximum(APART * noise, bin_ns))
        & inside.all(axis=1)
        & (found.amplitudes.sum(axis=-1) > 0).all(axis=1)
    )
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
    along_axis = SPEED_OF_LIGHT_M_PER_NS / 2 * calibration.instrument.ray_cosine()[here]
    variance = found.delay_std_ns**2 * misfit + calibration.pixel_delay_std_ns[here][:, None] ** 2
    if calibration.waveform_delay_std_ns is not None:
        variance = variance + found.influence**2 @ calibration.waveform_delay_std_ns**2
    depth = calibration.distance + found.delay_ns * along_axis[:, None]
    depth_std = np.sqrt(variance) * along_axis[:, None]
    white = fitted.white_photons(numbers, calibration)[:, None]
    relative = brightness_variance(calibration)[here][:, None]
    reflectance = found.amplitudes / white
    noise = found.amplitude_std**2 * misfit
    deviation = np.sqrt(noise + found.amplitudes**2 * relative) / white
    corrected = np.ones_like(depth)
    if fitted.range_correction:
        corrected = relative_range(depth, calibration) ** 2
        reflectance, deviation = (
            values * corrected[..., None] for values in (reflectance, deviation)
        )
        by_range = 2 * reflectance * (depth_std / np.abs(depth))[..., None]
        deviation = np.hypot(deviation, by_range)
    unknown = found.inflation > LARGEST_INFLATION
    reflectance[unknown] = deviation[unknown] = np.nan
    assert estimates.white_photons is not None
    assert estimates.fit_chi_square is not None
    assert estimates.fit_p_value is not None
    score = gamma_score(found.chi_square, _shape(found, fitted.tables))
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


def _shape(found: TwoReturns, tables: ModelTables) -> _Floats:
    """Shape of the distribution of χ² over its mean, as in `assessment`."""
    freedom = max(tables.wide.widths.size - 2 * tables.bands - 3, 1)
    return freedom**2 / (2 * freedom + found.spread)
