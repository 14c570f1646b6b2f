# SPDX-License-Identifier: Apache-2.0
"""Words of lanes to ticks and back."""

from __future__ import annotations

import numpy as np


def ticks_to_words(ticks: np.ndarray, /, *, lanes: int) -> np.ndarray:
    """Return the words of a signal given at each tick, lane 0 in the lowest bit.

    Parameters
    ----------
    ticks : numpy.ndarray of bool, shape (clocks * lanes,)
    lanes : int

    Returns
    -------
    numpy.ndarray of uint32, shape (clocks,)
    """
    return (ticks.reshape(-1, lanes) << np.arange(lanes)).sum(axis=1).astype(np.uint32)


def words_to_ticks(words: np.ndarray, /, *, lanes: int, signals: int = 1) -> np.ndarray:
    """Return signals at each tick from words that hold `lanes` ticks of each, side by side.

    Parameters
    ----------
    words : numpy.ndarray of unsigned integers, shape (clocks,) or (clocks, parts)
        Parts of 32 bits, lowest first, where a word is wider than 64 bits.
    lanes, signals : int

    Returns
    -------
    numpy.ndarray of bool, shape (signals, clocks * lanes)
    """
    count = lanes * signals
    if words.ndim == 2:
        raw = np.ascontiguousarray(words.astype("<u4")).view(np.uint8)
        bits = np.unpackbits(raw.reshape(len(words), -1), axis=1, bitorder="little")[:, :count]
    else:
        bits = (words[:, None] >> np.arange(count, dtype=words.dtype) & 1).astype(np.uint8)
    shaped = bits.reshape(len(words), signals, lanes).astype(bool)
    return shaped.transpose(1, 0, 2).reshape(signals, -1)
