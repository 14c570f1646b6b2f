# SPDX-License-Identifier: Apache-2.0
"""Cross-correlation of histograms and the centroid of its peak (paper, section 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hueflight.backend.fit import CENTROID_ROUNDS


def correlate(
    image: NDArray[np.floating], reference: NDArray[np.floating], max_lag: int
) -> NDArray[np.float32]:
    """Return the linear cross-correlation at lags −max_lag … max_lag.

    Parameters
    ----------
    image : ndarray, shape (pixel, bin)
        Counts in time order.
    reference : ndarray, shape (pixel, bin) or (bin,)
        Counts of the reference in the same order.
    max_lag : int
        Largest shift in bins; positive lags mean that the image comes later.

    Returns
    -------
    ndarray of float32, shape (pixel, 2·max_lag + 1)
        Σ_b image[b + lag] · reference[b].
    """
    bins = image.shape[-1]
    length = int(fft.next_fast_len(bins + max_lag, real=True))
    spectrum = fft.rfft(np.asarray(image, np.float32), length, axis=-1)
    spectrum *= np.conj(fft.rfft(np.asarray(reference, np.float32), length, axis=-1))
    circular = np.asarray(fft.irfft(spectrum, length, axis=-1, overwrite_x=True), np.float32)
    return np.concatenate(
        [circular[..., length - max_lag :], circular[..., : max_lag + 1]], axis=-1
    )


def peak_centroid(
    correlation: NDArray[np.floating],
    *,
    search: int,
    half_width: float,
    rounds: int = CENTROID_ROUNDS,
) -> NDArray[np.float64]:
    """Return the centroid of the middle peak of a correlation.

    The highest lag within ±search is refined by the weighted mean over ±half_width around it, above
    the lowest value in the search range (the pedestal that background adds). The edges of the
    window may fall inside a lag and follow the centroid for a few rounds, so that the result is not
    drawn to whole bins.

    Parameters
    ----------
    correlation : ndarray, shape (pixel, 2·max_lag + 1)
        Correlation as `correlate` gives it.
    search : int
        Half the range of lags in which the peak may lie, bins.
    half_width : float
        Half the window of the centroid, bins.
    rounds : int
        Rounds in which the window follows the centroid.

    Returns
    -------
    ndarray of float, shape (pixel,)
        Centroid in bins.
    """
    max_lag = correlation.shape[-1] // 2
    allowed = correlation[:, max_lag - search : max_lag + search + 1]
    pedestal = allowed.min(axis=-1, keepdims=True)
    weight = np.maximum(correlation - pedestal, 0).astype(np.float64)
    # integrals of the weight and of its first moment up to each edge between lags
    lags = np.arange(-max_lag, max_lag + 1)
    zero = np.zeros((weight.shape[0], 1))
    mass = np.concatenate([zero, np.cumsum(weight, axis=-1)], axis=-1)
    moment = np.concatenate([zero, np.cumsum(weight * lags, axis=-1)], axis=-1)
    centroid = allowed.argmax(axis=-1) - float(search)
    for _ in range(rounds):
        low = np.clip(centroid - half_width, -max_lag - 0.5, max_lag + 0.5) + max_lag + 0.5
        high = np.clip(centroid + half_width, -max_lag - 0.5, max_lag + 0.5) + max_lag + 0.5
        inside = _at(mass, high) - _at(mass, low)
        first = _at(moment, high) - _at(moment, low)
        np.divide(first, inside, out=centroid, where=inside > 0)
        np.clip(centroid, -search, search, out=centroid)  # a slope at the end must not lead out
    return centroid


def _at(table: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear look-up of each row of a table at its own fractional position."""
    index = np.minimum(position.astype(np.intp), table.shape[-1] - 2)
    rows = np.arange(table.shape[0])
    below, above = table[rows, index], table[rows, index + 1]
    return below + (above - below) * (position - index)
