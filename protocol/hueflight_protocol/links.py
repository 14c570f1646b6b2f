# SPDX-License-Identifier: Apache-2.0
"""What the links of a camera carry, and what frames of codes take of it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .frame_encoder import encode_frame
from .wire import DEFAULT_RUN

FT601_HZ = 100_000_000  #: clock of the FT601's bus of 4 bytes
OPAL_KELLY_HZ = 100_800_000  #: clock of Opal Kelly's bus of 4 bytes
LINKS = {
    "USB 2": 13 * 512 * 8000.0,  # packets of 512 bytes in each microframe
    "FT601": 4.0 * FT601_HZ,
    "Opal Kelly": 4.0 * OPAL_KELLY_HZ,
}
"""Most bytes per second that the links of the camera can carry, by link."""
_DRAWN = 8
"""Frames drawn for the mean size of a packet."""


@lru_cache(maxsize=256)
def packet_bytes(
    rows: int, cols: int, occupancy: float, *, code_bits: int, run: int = DEFAULT_RUN
) -> float:
    """Return the mean size of a packet of random codes, as the encoder makes it.

    Parameters
    ----------
    rows, cols : int
        Geometry.
    occupancy : float
        Share of pixels with a photon.
    code_bits : int
        Bits of a code.
    run : int, optional
        Pixels of a chunk.

    Returns
    -------
    float
        Bytes.
    """
    rng = np.random.default_rng(1)
    sizes = []
    for _ in range(_DRAWN):
        codes = rng.integers(1, 1 << code_bits, (rows, cols), np.uint16)
        codes[rng.random(codes.shape) >= occupancy] = 0
        packet = encode_frame(codes, sequence=0, frame=0, timestamp=0, code_bits=code_bits, run=run)
        sizes.append(len(packet))
    return float(np.mean(sizes))
