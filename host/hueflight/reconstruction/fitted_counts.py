# SPDX-License-Identifier: Apache-2.0
"""Counts that estimates of the joint fit were made from, for those who look at them again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hueflight.calibration import Calibration
from hueflight.fit.tables import ModelTables
from hueflight.model.pileup import coates_correction, photons_per_period
from hueflight.reconstruction.stored_counts import StoredCounts

_Floats = NDArray[np.float64]
_Numbers = NDArray[np.intp]


@dataclass(frozen=True)
class FittedCounts:
    """Counts that estimates were made from, and how.

    Attributes
    ----------
    light : ndarray, shape (row, col, bin), or StoredCounts
        Counts in time order.
    frames : ndarray of float, shape (row, col), or None
        Exposures; None where the loss of later photons of an exposure was left as it is.
    white : ndarray of float, shape (row, col)
        Photons of all bands that a white target at the distance of the reference would give.
    tables : ModelTables
        Tables of the fit.
    range_correction : bool
        Whether the estimates' reflectances are corrected for the distance.
    """

    light: NDArray[Any] | StoredCounts
    frames: _Floats | None
    white: _Floats
    tables: ModelTables
    range_correction: bool

    def of(self, numbers: _Numbers, photons: _Floats, calibration: Calibration) -> _Floats:
        """Return the counts of some pixels, corrected for lost photons as for the fit.

        Parameters
        ----------
        numbers : ndarray of int, shape (pixel,)
            Numbers of the pixels, row by row, rising.
        photons : ndarray of float, shape (row, col)
            Photons of all pixels.
        calibration : Calibration
            Calibration of the same instrument.

        Returns
        -------
        ndarray of float, shape (pixel, bin)
            Their counts.
        """
        light = self.light.reshape(-1, self.light.shape[-1])[numbers]
        rates = None
        if self.frames is not None:
            frames = self.frames.ravel()[numbers]
            rates = photons_per_period(photons.ravel()[numbers], frames, calibration.instrument)
        return coates_correction(light, rates).astype(np.float64)

    def white_photons(self, numbers: _Numbers, calibration: Calibration) -> _Floats:
        """Return the photons of each band that a white target at the reference's distance gives.

        Parameters
        ----------
        numbers : ndarray of int, shape (pixel,)
            Numbers of pixels.
        calibration : Calibration
            Calibration of the same instrument.

        Returns
        -------
        ndarray of float, shape (pixel, band)
            Photons.
        """
        white = self.white.ravel()[numbers]
        return white[:, None] * calibration.brightness / calibration.brightness.sum()


def arrival_ns(depth: _Floats, numbers: _Numbers, calibration: Calibration) -> _Floats:
    """Return when light from given depths arrives in pixels, their own delay included.

    Parameters
    ----------
    depth : ndarray of float, shape (pixel,)
        Depths, m.
    numbers : ndarray of int, shape (pixel,)
        Numbers of the pixels, row by row.
    calibration : Calibration
        Calibration of the same instrument.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Delays against the reference, ns.
    """
    along_axis = calibration.meters_per_ns.ravel()[numbers]
    own_ns = calibration.pixel_delay_ns.ravel()[numbers]
    return (depth - calibration.distance) / along_axis + own_ns
