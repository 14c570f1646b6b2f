# SPDX-License-Identifier: Apache-2.0
"""A picture of one surface in each pixel, for those who ask whether pixels see two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.fit.two_returns import best_single
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.fitted_counts import FittedCounts, arrival_ns
from hueflight.reconstruction.quality import Quality
from hueflight.reconstruction.range_correction import relative_range
from hueflight.reconstruction.shared_scores import FittedPixels, SharedModel, sum_scores

MOST_OTHERS = 512  #: pixels that tell what departs in the whole picture
FEWEST_OTHERS, LEAST_OTHERS = 30, 0.1  #: pixels, and share of all, that have to be left for that
TAILS_NS = (3.0, 15.0)  #: mean delays of exponential tails that are looked for
TYPICAL_DELAY_NS, TYPICAL_WIDTH, TYPICAL_TAIL = 0.3, 0.1, 0.3  #: sizes of departures

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FittedPicture:
    """Estimates, and the counts that they were made from.

    Attributes
    ----------
    estimates : Estimates
        Result of the joint fit with its assessment.
    fitted : FittedCounts
        Counts that it was made from.
    calibration : Calibration
        Calibration of the same instrument.
    """

    estimates: Estimates
    fitted: FittedCounts
    calibration: Calibration

    def light(self, numbers: NDArray[np.intp]) -> _Floats:
        """Return the counts of some pixels.

        Parameters
        ----------
        numbers : ndarray of int, shape (pixel,)
            Numbers of the pixels, row by row, rising.

        Returns
        -------
        ndarray of float, shape (pixel, bin)
            Their counts in time order.
        """
        return self.fitted.of(numbers, self.estimates.photons, self.calibration)

    def pixels(self, numbers: NDArray[np.intp], light: _Floats) -> FittedPixels:
        """Return the fit of one surface: from the estimates, where these state a depth.

        Parameters
        ----------
        numbers : ndarray of int, shape (pixel,)
            Numbers of the pixels.
        light : ndarray of float, shape (pixel, bin)
            Their counts.

        Returns
        -------
        FittedPixels
            Counts at the wide bins, and what the fit found.
        """
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
            counts=tables.wide_counts(light),
            arrival_ns=arrivals,
            offset_ns=calibration.pixel_delay_ns.ravel()[numbers],
            amplitudes=np.maximum(amplitudes, 0.0),
            background=background * calibration.bins.span_ns / calibration.bin_width_ns,
        )

    def model(self) -> SharedModel:
        """Return the departures that the pixels of a picture may share.

        Returns
        -------
        SharedModel
            Delays and widths of the pulses, slope of the background, and tails.
        """
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
        """Return the departures that the other pixels show, or all where few are left.

        Parameters
        ----------
        wanted : ndarray of bool, shape (row, col)
            Pixels that may see two surfaces.

        Returns
        -------
        ndarray of float, shape (direction,)
            Sizes of the departures of `model`.
        """
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
