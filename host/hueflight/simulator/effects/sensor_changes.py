# SPDX-License-Identifier: Apache-2.0
"""A sensor that changed since its calibration: pixels that turned hot, time bins of other width."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hueflight.model.time_bins import TimeBins

# Purposes 1 to 4 of a seed are taken by the sensor, its converter and the photons.
_HOT_PURPOSE, _WIDTH_PURPOSE = 5, 6


def pixels_turned_hot(
    hot: NDArray[np.bool_], dead: NDArray[np.bool_], *, share: float, seed: int
) -> NDArray[np.bool_]:
    """Return which pixels turn hot.

    Parameters
    ----------
    hot : ndarray of bool, shape (row, col)
        Pixels that were hot already; they are not drawn.
    dead : ndarray of bool, shape (row, col)
        Pixels that never fire; they are not drawn.
    share : float
        Fraction of the sensor's pixels to draw. All other pixels turn hot if fewer are left.
    seed : int
        Seed of the sensor.

    Returns
    -------
    ndarray of bool, shape (row, col)
        True for pixels that turned hot.
    """
    count = round(share * hot.size)
    order = np.random.default_rng([seed, _HOT_PURPOSE]).random(hot.shape)
    order = np.where(hot | dead, np.inf, order)
    places = np.argsort(order, axis=None, kind="stable")[:count]
    drawn = np.zeros(order.size, dtype=np.bool_)
    drawn[places] = np.isfinite(order.ravel()[places])
    return drawn.reshape(hot.shape)


def drifted_bins(bins: TimeBins, *, spread: float, seed: int) -> TimeBins:
    """Return time bins whose widths changed independently of each other.

    Parameters
    ----------
    bins : TimeBins
        Bins before the change.
    spread : float
        Standard deviation of the relative change of a width; changes beyond 3.5 standard
        deviations are limited to that.
    seed : int
        Seed of the sensor.

    Returns
    -------
    TimeBins
        The same codes with other widths. All bins together keep their span.
    """
    change = np.random.default_rng([seed, _WIDTH_PURPOSE]).standard_normal(bins.count)
    widths = bins.widths_ns * (1 + spread * np.clip(change, -3.5, 3.5))
    widths *= bins.span_ns / widths.sum()
    edges = bins.edges_ns[0] + np.concatenate([[0.0], np.cumsum(widths)])
    edges[-1] = bins.edges_ns[-1]
    return TimeBins(bins.codes, edges, bins.period_ns)
