"""Ambient light that is not constant in time: a linear ramp, or a slow exponential decay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    With *u* from 0 to 1 over the span of the bins, the cumulative share of the ramp of slope *r*
    is ``u - r·u·(1 - u)`` and that of the decay with time constant τ over the span *T* is
    ``(1 - exp(-u·T/τ)) / (1 - exp(-T/τ))``, what earlier periods left included. The two are mixed
    by `Effects.background_decay_share`.

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
    u = (bins.edges_ns - bins.edges_ns[0]) / bins.span_ns
    ramp = u - effects.background_ramp * u * (1 - u)
    constants = bins.span_ns / effects.background_decay_ns
    decay = np.expm1(-u * constants) / np.expm1(-constants)
    share = effects.background_decay_share
    return np.diff((1 - share) * ramp + share * decay)
