# SPDX-License-Identifier: Apache-2.0
"""How many pairs of surfaces the counts of one pixel tell at all, and how many are found."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import second_returns
from acceptance import Row
from numpy.typing import NDArray
from outside_model import COLORS, amplitudes, calibrated, drawn, edges_ns, expected
from pair_oracle import Found, Oracle

import hueflight as hf

#: colors of both surfaces, distance between them, photons
CELLS = (
    ("green", "white", 4.0, (300, 1500)),
    ("green", "white", 4.5, (300, 300)),
    ("green", "white", 4.5, (300, 1500)),
)
CERTAIN = 30.0  #: twice the log-likelihood ratio that fewer than 1 of 1000 single surfaces reach

Floats = NDArray[np.float64]


def rows(quick: bool) -> Iterator[Row]:
    """Pairs found by exhaustive search and by the project, and the same of a single surface."""
    size = (3, 4) if quick else (8, 8)
    oracle, calibration = Oracle(second_returns.RANGE_M), calibrated(*size)
    for near, far, apart, (first, second) in CELLS:
        far_m = second_returns.NEAR_M + apart
        light = amplitudes(COLORS[near], first), amplitudes(COLORS[far], second)
        background = (first + second) / 10
        mean = expected(second_returns.NEAR_M, light[0]) + expected(far_m, light[1], background)
        rng = np.random.default_rng([31, first, second, round(100 * apart)])
        counts = drawn(mean * np.ones((*size, 1)), rng)
        within = second_returns.tolerance_m(far_m, *light, background)
        truth = np.array([second_returns.NEAR_M, far_m])
        found = _search(oracle, counts)
        right = [bool((np.abs(one.pair_m - truth) < within).all()) for one in found]
        certain = [
            bool(good and one.gain > CERTAIN) for good, one in zip(right, found, strict=True)
        ]
        image = hf.reconstruct(
            counts, calibration, depth_range=second_returns.RANGE_M, second_returns=True
        )
        pair = np.stack([image["depth"].values, image["second_depth"].values], axis=-1)
        ours = (np.abs(pair - truth) < within).all(axis=-1)
        yield Row(
            f"{near} {apart:g} m before {far}, {first} and {second} photons: right pair by "
            "exhaustive search with the true pulses in each pixel alone; and beyond "
            "chance as well; `joint` with neighbors",
            f"{np.mean(right):.0%}; {np.mean(certain):.0%}; {ours.mean():.0%}",
        )
    mean = expected(second_returns.NEAR_M + 4, amplitudes(COLORS["white"], 1800), 180)
    found = _search(oracle, drawn(mean * np.ones((*size, 1)), np.random.default_rng(32)))
    gains = np.array([one.gain for one in found])
    yield Row(
        "white of 1800 photons alone: twice the log-likelihood ratio of the best pair, median and "
        "greatest",
        f"{np.median(gains):.0f}, {gains.max():.0f} of {gains.size}",
    )


def _search(oracle: Oracle, histogram: NDArray[np.uint32]) -> list[Found]:
    """Search all pixels of raw counts (row, col, code)."""
    bins = edges_ns().size - 1
    fine = histogram.reshape(-1, histogram.shape[-1])[:, bins:0:-1]
    starts = np.searchsorted(edges_ns(), oracle.edges[:-1] - 1e-9)
    return [oracle.find(one) for one in np.add.reduceat(fine, starts, axis=-1).astype(float)]
