# SPDX-License-Identifier: Apache-2.0
"""Results of the joint fit as a picture, in few arrays that are filled pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.backend.fit_results import RESULT_PLANES
from hueflight.reconstruction.estimates import Estimates

#: order of `ResultPlanes.numbers`; the names are those of `Estimates`
NUMBERS = (
    *("depth", "depth_std", "other_depth", "background", "photons", "white_photons"),
    *("fit_chi_square", "fit_p_value"),
)
ASSESSED = NUMBERS[-2:]  #: results of the test whether one surface explains the counts


@dataclass(frozen=True)
class ResultPlanes:
    """Results of every pixel of a picture.

    Attributes
    ----------
    numbers : ndarray of float, shape (plane, row, col)
        Planes in the order of `NUMBERS`.
    reflectances : ndarray of float32, shape (2, row, col, band)
        Reflectances and their standard deviations.
    quality : ndarray of uint16, shape (row, col)
        Bits of `Quality`.
    """

    numbers: NDArray[np.floating]
    reflectances: NDArray[np.float32]
    quality: NDArray[np.uint16]

    def estimates(self, *, assessed: bool) -> Estimates:
        """Return the same results by their names, as views.

        Parameters
        ----------
        assessed : bool
            It was tested whether one surface explains the counts.

        Returns
        -------
        Estimates
            Results of all pixels.
        """
        values, deviations = np.moveaxis(self.reflectances, -1, 1)
        planes = dict(zip(NUMBERS, self.numbers, strict=True))
        if not assessed:
            planes |= dict.fromkeys(ASSESSED)
        return Estimates(
            reflectance=values, reflectance_std=deviations, quality=self.quality, **planes
        )

    def copy(self) -> ResultPlanes:
        """Return a copy in single precision, in which images are."""
        return ResultPlanes(
            self.numbers.astype(np.float32), self.reflectances.copy(), self.quality.copy()
        )


def empty_planes(shape: tuple[int, ...], bands: int) -> ResultPlanes:
    """Return planes to be filled.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    bands : int
        Number of bands.

    Returns
    -------
    ResultPlanes
        The planes, whose values are not set.
    """
    return ResultPlanes(
        np.empty((RESULT_PLANES, *shape)),
        np.empty((2, *shape, bands), np.float32),
        np.empty(shape, np.uint16),
    )
