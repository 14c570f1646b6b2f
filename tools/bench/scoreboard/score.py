# SPDX-License-Identifier: Apache-2.0
"""How well depth from some photons predicts others."""

from __future__ import annotations

import numpy as np
from data_sets import Half
from numpy.typing import NDArray
from published import METERS_PER_NS

BACKGROUND_SHARES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9)


def held_out_bits(depth: NDArray[np.float64], unseen: Half) -> float:
    """Mean information of a depth about the arrival times of photons that did not make it.

    Parameters
    ----------
    depth : ndarray of float, shape (row, col)
        Depth from other photons, m; NaN where there is none.
    unseen : Half
        The photons to predict.

    Returns
    -------
    float
        Bits per photon against the prediction that all times are alike. The share of background
        photons is that with which the depth does best. A pixel without depth predicts nothing and
        counts 0.
    """
    counts = unseen.counts[..., unseen.calibration.bins.codes]
    row, col, code = np.nonzero(counts)
    number = counts[row, col, code]
    since_ns = unseen.times_ns[code] - depth[row, col] / METERS_PER_NS
    known = np.isfinite(since_ns)
    pulse = np.zeros(row.size)
    pulse[known] = unseen.pulse(np.remainder(since_ns[known], unseen.period_ns))
    best = max(
        float(number[known] @ np.log2(share + (1 - share) * pulse[known]))
        for share in BACKGROUND_SHARES
    )
    return best / float(number.sum())
