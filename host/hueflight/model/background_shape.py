# SPDX-License-Identifier: Apache-2.0
"""Background that is not constant in time: a linear ramp, or a slow exponential decay."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from hueflight.errors import HueflightError


@dataclass(frozen=True, kw_only=True)
class BackgroundShape:
    """How the background of a picture is distributed over the time bins.

    Attributes
    ----------
    slope : float
        Relative slope over the span of the bins, -1 to 1. At 0.5, for example, the background
        rises linearly from 0.5 to 1.5 times its mean; it falls if the value is negative.
    decay_share : float
        Fraction of the background that decays exponentially from the start of each period, 0 to 1.
    decay_ns : float
        Time constant of that fraction, ns.

    Raises
    ------
    HueflightError
        If a value is out of range.
    """

    slope: float = 0.0
    decay_share: float = 0.0
    decay_ns: float = 50.0

    def __post_init__(self) -> None:
        if not -1 <= self.slope <= 1:
            raise HueflightError(
                f"slope = {self.slope!r}: must lie in -1..1, so that no light is negative"
            )
        if not 0 <= self.decay_share <= 1:
            raise HueflightError(f"decay_share = {self.decay_share!r}: must lie in 0..1")
        if not (isfinite(self.decay_ns) and self.decay_ns > 0):
            raise HueflightError(f"decay_ns = {self.decay_ns!r}: must be a finite number above 0")

    def __str__(self) -> str:
        """Return the shape in words, such as ``slope +0.50``."""
        if self.decay_share == 0:
            return f"slope {self.slope:+.2f}" if self.slope else "flat"
        decay = f"{self.decay_share:.0%} decays with {self.decay_ns:g} ns"
        return f"{decay}, the rest with slope {self.slope:+.2f}"

    def shares(self, edges_ns: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the fraction of the background in each bin.

        With *u* from 0 to 1 over the span *T* of the bins, the density is ``1 + r·(2·u - 1)`` for
        the ramp of slope *r*, and proportional to ``exp(-u·T/τ)`` for the decay with time constant
        τ, what earlier periods left included.

        Parameters
        ----------
        edges_ns : ndarray of float, shape (bin + 1,)
            Edges of the bins in ascending order, ns.

        Returns
        -------
        ndarray of float, shape (bin,)
            Fractions; they sum to 1.
        """
        edges = np.asarray(edges_ns, np.float64)
        span_ns = edges[-1] - edges[0]
        u = (edges - edges[0]) / span_ns
        ramp = np.diff(edges) / span_ns * (1 + self.slope * (u[1:] + u[:-1] - 1))
        if self.decay_share == 0:
            return ramp
        constants = span_ns / self.decay_ns
        decay = np.diff(np.expm1(-u * constants)) / np.expm1(-constants)
        return (1 - self.decay_share) * ramp + self.decay_share * decay


FLAT = BackgroundShape()  #: constant in time
