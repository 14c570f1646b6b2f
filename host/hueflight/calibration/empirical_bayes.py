# SPDX-License-Identifier: Apache-2.0
"""Empirical-Bayes estimates of a quantity of each pixel.

A value measured in one pixel is noisier than a mean over many. Rows, columns and pixels each keep
as much of their own deviation as exceeds the noise: the linear empirical-Bayes estimate of a
hierarchical model (Efron and Morris, JASA 70, 311, 1975).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def shrink_to_line_means(
    values: NDArray[np.floating], variance: NDArray[np.floating], usable: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate each pixel's true value from its measured value, its row, its column and the mean.

    Parameters
    ----------
    values : ndarray of float, shape (row, col)
        Measured values.
    variance : ndarray of float, shape (row, col)
        Variances of the measurement.
    usable : ndarray of bool, shape (row, col)
        Pixels that count; the others get an estimate from their row and column.

    Returns
    -------
    best : ndarray of float, shape (row, col)
        Estimates.
    left : ndarray of float, shape (row, col)
        Their variances.
    """
    weight = np.where(usable, 1 / np.where(usable, variance, 1.0), 0.0)
    known = np.where(usable, values, 0.0)
    center = float((weight * known).sum() / weight.sum())
    rest = np.where(usable, values - center, 0.0)
    guess = np.full(values.shape, center)
    unsure = np.zeros(values.shape)
    for axis in (1, 0):  # what a row has in common, then a column
        line, line_variance = _line_effect(rest, weight, axis)
        guess, unsure = guess + line, unsure + line_variance
        rest = np.where(usable, rest - line, 0.0)
    noise = 1 / np.where(usable, weight, 1.0)
    own = _excess_variance(rest[usable] ** 2 - noise[usable], weight[usable])
    keep = np.where(usable, own / (own + noise), 0.0)
    # what a pixel keeps of its own makes up for its line's error
    return guess + keep * rest, (1 - keep) ** 2 * unsure + np.where(usable, keep * noise, own)


def _line_effect(
    rest: NDArray[np.float64], weight: NDArray[np.float64], axis: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shrunken weighted mean along an axis, kept as a dimension, and its remaining variance."""
    total = weight.sum(axis=axis, keepdims=True)
    mean = (weight * rest).sum(axis=axis, keepdims=True) / np.maximum(total, 1e-300)
    # the noise of the mean, pixels' own deviations included: from the scatter about it
    count = (weight > 0).sum(axis=axis, keepdims=True)
    scatter = (weight * (rest - mean) ** 2).sum(axis=axis, keepdims=True)
    per_weight = np.maximum(scatter / np.maximum(count - 1, 1), 1.0)
    noise = per_weight / np.maximum(total, 1e-300)
    filled = total > 0
    common = _excess_variance((mean**2 - noise)[filled], (1 / noise)[filled])
    keep = np.where(filled, common / (common + noise), 0.0)
    return keep * mean, np.where(filled, keep * noise, common)


def _excess_variance(excess: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    """Variance beyond the noise, 0 where there is none."""
    if excess.size < 2:
        return 0.0 if not excess.size else max(float(excess[0]), 0.0)
    return max(float((excess * weight).sum() / weight.sum()), 0.0)
