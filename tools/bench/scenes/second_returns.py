# SPDX-License-Identifier: Apache-2.0
"""Pixels that see two surfaces by their own counts, such as glass in front of a wall."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from acceptance import Row
from numpy.typing import NDArray
from outside_model import (
    COLORS,
    METERS_PER_NS,
    PERIOD_NS,
    amplitudes,
    band_shares,
    calibrated,
    drawn,
    edges_ns,
    expected,
)

import hueflight as hf

NEAR_M = 0.8
SPACING_M = 30 * METERS_PER_NS  #: between successive pulses
NEAR_SPACING_M = 0.3  #: about it, where the surfaces' pulses coincide and figures are only stated
RANGE_M = (0.0, 8.0)
PHOTONS = ((300, 300), (1500, 300), (300, 1500))
PAIRS = (("white", "white"), ("green", "white"), ("red", "blue"))
APART_M = (1.5, 2.0, 3.0, 4.0, 6.0, 4.5)
WRONG_BOUNDS, WRONG_M = 4.0, 0.15  #: a pair is wrong if a depth is farther off than both

Floats = NDArray[np.float64]


def rows(quick: bool) -> Iterator[Row]:
    """Right pairs and errors of both depths, and pixels that see one surface."""
    size = (12, 16) if quick else (24, 32)
    calibration = calibrated(*size)
    false: list[NDArray[np.bool_]] = []
    for near, far in PAIRS:
        for apart in APART_M:
            shares, errors = [], []
            for first, second in PHOTONS:
                light = amplitudes(COLORS[near], first), amplitudes(COLORS[far], second)
                share, error, beside = _pane(size, calibration, light, apart)
                shares.append(share)
                errors.append(error)
                false.append(beside)
            ratio = np.sqrt(np.mean(np.concatenate(errors, axis=1) ** 2, axis=-1))
            stated = abs(apart - SPACING_M) <= NEAR_SPACING_M
            # the standard error of a ratio from 720 pixels is 2.6 %
            yield Row(
                f"two returns {apart:g} m apart, {near} before {far}, 300 photons each and 5:1 "
                "either way: right pair, worst; RMSE ÷ bound of the near and the far depth",
                f"{min(shares):.1%}; {ratio[0]:.2f}, {ratio[1]:.2f}",
                "stated" if stated else "≥ 97 %; ≤ 1.15", "" if stated else "99.5 %; 1.05",
                None if stated else bool(min(shares) >= 0.97 and ratio.max() <= 1.15),
            )  # fmt: skip
    share = float(np.mean(np.concatenate(false)))
    yield Row(
        "two returns: flagged, of the pixels beside the pane", f"{share:.2%}", "≤ .2 %", "≤ .1 %",
        share <= 0.002,
    )  # fmt: skip


def _pane(
    size: tuple[int, int], calibration: hf.Calibration, light: tuple[Floats, Floats], apart: float
) -> tuple[float, Floats, NDArray[np.bool_]]:
    """Share of right pairs behind a pane, their errors over the bounds, and flags beside it."""
    far_m = NEAR_M + apart
    total = light[0].sum() + light[1].sum()
    behind = expected(NEAR_M, light[0]) + expected(far_m, light[1], total / 10)
    wall = expected(far_m, light[1] * (total / light[1].sum()), total / 10)
    pane = np.arange(size[1]) < size[1] // 3
    mean = np.where(pane[:, None], behind, wall) * np.ones((*size, 1))
    seed = [21, round(light[0].sum()), round(light[1].sum()), round(100 * apart)]
    counts = drawn(mean, np.random.default_rng(seed))
    image = hf.reconstruct(counts, calibration, depth_range=RANGE_M)
    two = (image["quality"].values & int(hf.Quality.TWO_RETURNS)) != 0
    found = np.stack([image["depth"].values, image["second_depth"].values])
    bounds = two_surface_bounds(far_m, *light, total / 10)
    error = np.abs(found - np.array([NEAR_M, far_m])[:, None, None])
    right = two & (error < np.maximum(WRONG_BOUNDS * bounds, WRONG_M)[:, None, None]).all(axis=0)
    return float(right[:, pane].mean()), error[:, right] / bounds[:, None], two[:, ~pane].ravel()


def two_surface_bounds(far_m: float, near: Floats, far: Floats, background: float) -> Floats:
    """Return the Cramér-Rao bounds of both depths, m: all amplitudes and the background unknown."""
    step = 1e-4

    def slope(depth: float, light: Floats) -> Floats:
        return (expected(depth + step, light) - expected(depth - step, light)) / (2 * step)

    mean = expected(NEAR_M, near) + expected(far_m, far, background)
    width = np.diff(edges_ns())[None] / PERIOD_NS
    parts = [slope(NEAR_M, near)[None], slope(far_m, far)[None]]
    model = np.concatenate([*parts, band_shares(NEAR_M), band_shares(far_m), width])
    information = (model / np.maximum(mean, 1e-12)) @ model.T
    return np.sqrt(np.diag(np.linalg.inv(information))[:2])
