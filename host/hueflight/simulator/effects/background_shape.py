# SPDX-License-Identifier: Apache-2.0
"""Ambient light that is not constant in time: a linear ramp, or a slow exponential decay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hueflight.model.background_shape import BackgroundShape
from hueflight.model.time_bins import TimeBins
from hueflight.simulator.effects.settings import Effects


@dataclass(frozen=True)
class UnevenBackground:
    """Steady light of each pixel that all bins share unevenly.

    Attributes
    ----------
    photons : ndarray of float, shape (row, col)
        Detectable photons per period.
    shares : ndarray of float, shape (bin,)
        Fraction of them in each time bin, in the order of time.
    """

    photons: NDArray[np.float64]
    shares: NDArray[np.float64]

    def rows(self, rows: slice) -> UnevenBackground:
        """Return the same light for some rows of the picture."""
        return UnevenBackground(self.photons[rows], self.shares)


def background_shares(bins: TimeBins, effects: Effects) -> NDArray[np.float64]:
    """Return the fraction of the ambient light that falls into each time bin.

    Parameters
    ----------
    bins : TimeBins
        Bins of the simulated converter.
    effects : Effects
        Shape of the ambient light.

    Returns
    -------
    ndarray of float, shape (bin,)
        Shares in the order of time; they sum to 1.
    """
    shape = BackgroundShape(
        slope=effects.background_ramp,
        decay_share=effects.background_decay_share,
        decay_ns=effects.background_decay_ns,
    )
    return shape.shares(bins.edges_ns)
