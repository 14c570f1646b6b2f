# SPDX-License-Identifier: Apache-2.0
"""How well depth from some photons predicts others."""

from __future__ import annotations

import numpy as np
from data_sets import Half
from numpy.typing import NDArray
from published import METERS_PER_NS

BACKGROUND_SHARES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9)
FIRST_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)
"""Shares of the first of two surfaces in the light of both that are tried."""


def held_out_bits(depth: NDArray[np.float64], unseen: Half) -> float:
    """Mean information of a depth about the arrival times of photons that did not make it.

    Parameters
    ----------
    depth : ndarray of float, shape (row, col) or (2, row, col)
        Depth from other photons, or two of them, m; NaN where there is none.
    unseen : Half
        The photons to predict.

    Returns
    -------
    float
        Bits per photon against the prediction that all times are alike. The share of background
        photons is that with which the depth does best, and so is the share of the first of two
        surfaces. A pixel without depth predicts nothing and counts 0.
    """
    counts = unseen.counts[..., unseen.calibration.bins.codes]
    row, col, code = np.nonzero(counts)
    number = counts[row, col, code]
    first, *others = [
        _pulse_after(each[row, col], unseen, code) for each in depth.reshape(-1, *counts.shape[:2])
    ]
    known = np.isfinite(first)
    mixtures = [first]
    for other in others:
        second = np.where(np.isfinite(other), other, first)
        mixtures += [share * first + (1 - share) * second for share in FIRST_SHARES]
    best = max(
        float(number[known] @ np.log2(share + (1 - share) * pulse[known]))
        for share in BACKGROUND_SHARES
        for pulse in mixtures
    )
    return best / float(number.sum())


def _pulse_after(
    depth: NDArray[np.float64], unseen: Half, code: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Density of a pulse from each depth at each code; NaN where there is no depth."""
    since_ns = unseen.times_ns[code] - depth / METERS_PER_NS
    known = np.isfinite(since_ns)
    pulse = np.full(since_ns.size, np.nan)
    pulse[known] = unseen.pulse(np.remainder(since_ns[known], unseen.period_ns))
    return pulse
