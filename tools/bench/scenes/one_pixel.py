# SPDX-License-Identifier: Apache-2.0
"""Two surfaces in one pixel alone: how much more light than an ideal test the misfit test needs.

The ideal test knows both surfaces and asks whether the nearest model of one surface explains the
counts: twice the logarithm of its likelihood ratio has the mean λ, twice the Kullback-Leibler
divergence between the two, and the variance 4 λ. Its power at a false-alarm rate of 1e-3 is
Φ(√λ − 3.09), and λ is proportional to the photons.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from acceptance import Row
from numpy.typing import NDArray
from outside_model import (
    COLORS,
    PERIOD_NS,
    amplitudes,
    band_shares,
    calibrated,
    drawn,
    edges_ns,
    expected,
)
from scipy.optimize import minimize_scalar
from scipy.stats import norm

import hueflight as hf

NEAR_M = 1.0
FALSE_ALARMS, POWER = 1e-3, 0.9
BACKGROUND = 0.1  #: photons of background for each of the surfaces
RELATIVE = (0.85, 1.0, 1.2, 1.45, 1.75)  #: photons that are tried, over those of the ideal test
#: near and far color, distance between them (m), share of the near one's photons
CASES = (
    ("white", "white", 0.5, 0.5),
    ("white", "white", 0.75, 0.5),
    ("white", "white", 1.0, 0.5),
    ("white", "white", 1.0, 0.8),
    ("red", "blue", 0.2, 0.5),
    ("red", "blue", 0.5, 0.5),
    ("green", "white", 0.5, 0.5),
)

Floats = NDArray[np.float64]


def rows(quick: bool) -> Iterator[Row]:
    """Photons for a power of 90 %, over those that the ideal test needs."""
    size = (24, 32) if quick else (64, 64)
    calibration = calibrated(*size)
    for number, (near, far, apart, share) in enumerate(CASES):
        light = share * amplitudes(COLORS[near], 1), (1 - share) * amplitudes(COLORS[far], 1)
        needed = (norm.isf(FALSE_ALARMS) + norm.ppf(POWER)) ** 2
        ideal = needed / (2 * divergence(apart, *light))
        powers = []
        for relative in RELATIVE:
            mean = ideal * relative * _mean(apart, *light) * np.ones((*size, 1))
            counts = drawn(mean, np.random.default_rng([31, number, round(100 * relative)]))
            image = hf.reconstruct(counts, calibration, second_returns=False)
            powers.append(((image["quality"].values & int(hf.Quality.MISFIT)) != 0).mean())
        # probits of the power rise linearly with the root of the photons
        scores = norm.ppf(np.clip(powers, 0.5 / size[0] / size[1], 1 - 0.5 / size[0] / size[1]))
        slope, start = np.polyfit(np.sqrt(RELATIVE), scores, 1)
        ratio = float(((norm.ppf(POWER) - start) / slope) ** 2)
        same = near == far
        limit, aim = (1.4, 1.15) if same else (1.6, 1.3)
        what = f"{near} before {far}, {100 * apart:g} cm, share of the near one {share:g}"
        yield Row(
            f"one pixel alone, {what}: photons for 90 % power at 1e-3, over the ideal test's",
            f"{ratio:.2f} ({ideal * ratio:.0f} photons)", f"≤ {limit}", f"{aim}", ratio <= limit,
        )  # fmt: skip


def _mean(apart: float, near: Floats, far: Floats) -> Floats:
    return expected(NEAR_M, near) + expected(NEAR_M + apart, far, BACKGROUND)


def divergence(apart: float, near: Floats, far: Floats) -> float:
    """Return the Kullback-Leibler divergence from the nearest model of one surface.

    Parameters
    ----------
    apart : float
        Distance between the surfaces, m.
    near, far : ndarray of float, shape (band,)
        Photons of each band from either surface; they sum to one photon.
    """
    truth = _mean(apart, near, far)
    flat = np.diff(edges_ns())[None] / PERIOD_NS

    def at(depth: float) -> float:
        model = np.concatenate([band_shares(depth), flat])
        theta = np.append(near + far, BACKGROUND)
        for _ in range(300):  # expectation maximisation: the minimum over all amplitudes
            theta = theta * (model @ (truth / (theta @ model))) / model.sum(axis=-1)
        mean = theta @ model
        return float((truth * np.log(truth / mean) - truth + mean).sum())

    grid = np.linspace(NEAR_M - 0.1, NEAR_M + apart + 0.1, 15)
    best = grid[np.argmin([at(depth) for depth in grid])]
    step = grid[1] - grid[0]
    return float(minimize_scalar(at, bounds=(best - step, best + step), method="bounded").fun)
