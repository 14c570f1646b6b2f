# SPDX-License-Identifier: Apache-2.0
"""Pile-up where an exposure is one period and nearly every exposure holds a photon."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from acceptance import Row
from outside_model import COLORS, amplitudes, calibrated, drawn_first_photons, expected

import hueflight as hf

DEPTH_M = 1.3
FRAMES = 20_000


def rows(quick: bool) -> Iterator[Row]:
    """Mean depth and band ratios of many pixels, whose noise is far below the limits."""
    size = (16, 16) if quick else (40, 40)
    calibration = calibrated(*size, photons=30_000, one_led_photons=10_000, one_period=True)
    for occupancy in (0.6, 0.9):
        for number, name in enumerate(("white", "green")):
            light = amplitudes(COLORS[name], 1.0)
            mean = expected(DEPTH_M, light, 0.1)
            mean *= -np.log1p(-occupancy) / mean.sum()
            counts = drawn_first_photons(
                np.ones((*size, 1)) * mean, np.random.default_rng([5, number]), frames=FRAMES
            )
            off, worst = _errors(hf.reconstruct(counts, calibration), COLORS[name])
            plain = _errors(
                hf.reconstruct(counts, calibration, pileup_correction=False), COLORS[name]
            )
            what = f"pile-up, one period per exposure, occupancy {occupancy}, {name}"
            yield Row(
                f"{what}: depth bias",
                f"{off:.2f} mm; not corrected {plain[0]:.0f} mm", "≤ 1 mm", "",
                bool(abs(off) <= 1),
            )  # fmt: skip
            yield Row(
                f"{what}: ratio of a band to the brightest, worst band",
                f"{worst:.2%} off; not corrected {plain[1]:.0%}", "≤ 1 %", "",
                bool(worst <= 0.01),
            )  # fmt: skip


def _errors(image, reflectance) -> tuple[float, float]:
    """Return the bias of depth, mm, and the largest relative error of a band's ratio.

    Ratios are those of a band to the one with the most light; errors of dark bands are relative to
    the light that white would have there, as everywhere.
    """
    off = 1e3 * (float(np.nanmean(image["depth"].values)) - DEPTH_M)
    found = np.nanmean(image["reflectance"].values, axis=(0, 1))
    brightest = int(np.argmax(reflectance))
    ratio = found / found[brightest]
    return off, float(np.abs(ratio - reflectance / reflectance[brightest]).max())
