# SPDX-License-Identifier: Apache-2.0
"""Windows of pulses: which bins belong to which band, and the counts in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PulseWindow:
    """Bins [start, stop) that hold one pulse of a band, in time order.

    Attributes
    ----------
    band : int
        Index of the band.
    start : int
        First bin; negative where the window wraps around the start of the period.
    stop : int
        Bin after the last one; beyond the number of bins where the window wraps around the end.
    """

    band: int
    start: int
    stop: int


def window_sums(
    counts: NDArray[np.floating],
    windows: tuple[PulseWindow, ...],
    shift: NDArray[np.integer],
    *,
    bands: int,
    circular: bool,
) -> NDArray[np.float64]:
    """Sum the counts in each band's windows, moved by each pixel's own shift (paper, eq. 2).

    Parameters
    ----------
    counts : ndarray, shape (pixel, bin)
        Counts in time order.
    windows : tuple of PulseWindow
        Windows of all pulses.
    shift : ndarray of int, shape (pixel,)
        Whole bins by which the windows move; positive when the light arrives later.
    bands : int
        Number of bands.
    circular : bool
        True where windows wrap around the period; False to cut them off at the first and last bin.

    Returns
    -------
    ndarray of float, shape (band, pixel)
        Counts in the windows of each band.
    """
    pixels, count = counts.shape
    running = np.concatenate(
        [np.zeros((pixels, 1)), np.cumsum(counts, axis=-1, dtype=np.float64)], axis=-1
    )
    rows = np.arange(pixels)

    def up_to(bin_index: NDArray[np.integer]) -> NDArray[np.float64]:
        if not circular:
            return running[rows, np.clip(bin_index, 0, count)]
        turns, rest = np.divmod(bin_index, count)
        return running[rows, rest] + turns * running[:, -1]

    sums = np.zeros((bands, pixels))
    for window in windows:
        sums[window.band] += up_to(window.stop + shift) - up_to(window.start + shift)
    return sums
