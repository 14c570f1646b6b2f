# SPDX-License-Identifier: Apache-2.0
"""A serial line to a simulated design: bytes to levels on its pin, levels to bytes."""

from __future__ import annotations

import math

import numpy as np

from hueflight_protocol.errors import HueflightError


class LineError(HueflightError):
    """The levels of a line are not valid bytes."""


def line_levels(data: bytes, /, *, clocks_per_bit: float, idle_bits: int = 0) -> np.ndarray:
    """Return the level of the line in each clock while bytes are sent, 8N1.

    Parameters
    ----------
    data : bytes
    clocks_per_bit : float
        Need not be whole; each edge is moved to the next clock.
    idle_bits : int
        Bits of rest after the last stop bit.

    Returns
    -------
    numpy.ndarray of uint8, shape (clocks,)
    """
    sent = np.frombuffer(data, np.uint8)
    bits = np.ones((len(sent), 10), np.uint8)
    bits[:, 0] = 0
    bits[:, 1:9] = sent[:, None] >> np.arange(8) & 1
    flat = np.concatenate((bits.reshape(-1), np.ones(idle_bits, np.uint8)))
    edges = np.ceil(np.arange(len(flat) + 1) * clocks_per_bit).astype(int)
    return np.repeat(flat, np.diff(edges))


class LineReader:
    """Bytes out of the levels of a line, which come in pieces.

    Parameters
    ----------
    clocks_per_bit : float
    """

    def __init__(self, *, clocks_per_bit: float) -> None:
        self._clocks_per_bit = clocks_per_bit
        self._levels = np.ones(0, np.uint8)

    def feed(self, levels: np.ndarray, /) -> bytes:
        """Take levels, one a clock; return the bytes that they complete.

        Raises
        ------
        LineError
            If a byte has no stop bit.
        """
        levels = np.concatenate((self._levels, levels.astype(np.uint8)))
        middles = np.floor((np.arange(10) + 0.5) * self._clocks_per_bit).astype(int)
        length = math.ceil(10 * self._clocks_per_bit)
        out = bytearray()
        at = 0
        falls = np.flatnonzero(levels == 0)
        while True:
            following = falls[np.searchsorted(falls, at) :]
            if len(following) == 0:
                at = len(levels)
                break
            start = int(following[0])
            if start + length > len(levels):
                at = start
                break
            bits = levels[start + middles]
            if bits[0] or not bits[9]:
                raise LineError(f"levels {bits.tolist()} are no byte: no start or stop bit")
            out.append(int(bits[1:9] @ (1 << np.arange(8))))
            at = start + int(middles[9])
        self._levels = levels[at:]
        return bytes(out)
