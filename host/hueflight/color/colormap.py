# SPDX-License-Identifier: Apache-2.0
"""The colour map of all pictures: viridis, perceptually uniform."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NO_DATA = (176, 176, 176)  #: grey, which does not occur in the colour map
TABLE_SIZE = 256  #: number of colours that `table` gives

# Thirty-three of the 256 colours of viridis (S. van der Walt and N. Smith, 2015, public domain);
# between them straight lines stay within three of 255 steps of the original.
_NODES = bytes.fromhex(
    "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d"
    "2f6b8e2c728e297a8e26828e23898e21918c1f988b1fa08822a78528ae8032b67a"
    "3fbc734ec36b5ec96270cf5784d44b98d83eaddc30c2df23d8e219ece51bfde725"
)
_VIRIDIS = np.frombuffer(_NODES, dtype=np.uint8).reshape(-1, 3)


def table() -> NDArray[np.uint8]:
    """List the colours of the map at evenly spaced values.

    Returns
    -------
    ndarray of uint8, shape (256, 3)
        Red, green and blue, from the lowest value to the highest.
    """
    return colours(np.linspace(0, 1, TABLE_SIZE)[None], 0, 1)[0]


def colours(plane: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    """Colour values by the colour map.

    Parameters
    ----------
    plane : ndarray of float, shape (row, col)
        The values; NaN becomes `NO_DATA`.
    low, high : float
        Values of the first and the last colour, which also stand for everything beyond them.

    Returns
    -------
    ndarray of uint8, shape (row, col, 3)
        Red, green and blue.

    Examples
    --------
    >>> colours(np.array([[0.0, np.nan, 1.0]]), 0, 1).tolist()
    [[[68, 1, 84], [176, 176, 176], [253, 231, 37]]]
    """
    share = np.clip((np.asarray(plane, dtype=np.float64) - low) / (high - low), 0, 1)
    known = np.isfinite(share)
    position = np.where(known, share, 0.0) * (len(_VIRIDIS) - 1)
    channels = [np.interp(position, np.arange(len(_VIRIDIS)), table) for table in _VIRIDIS.T]
    pixels = np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
    pixels[~known] = NO_DATA
    return pixels
