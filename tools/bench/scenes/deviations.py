# SPDX-License-Identifier: Apache-2.0
"""Stated deviations where the calibration is noisy or the background strong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from acceptance import Row
from outside_model import amplitudes, calibrated, drawn, expected

import hueflight as hf

DEPTH_M = 1.3
WHITE = np.ones(9)


def rows(quick: bool) -> Iterator[Row]:
    """Coverage of 68 % intervals with references of few frames and with ten times the signal."""
    size = (32, 40) if quick else (64, 96)
    few = calibrated(*size, photons=300, one_led_photons=100)
    plain = calibrated(*size)
    cases = [(few, "reference of 300 photons a pixel", photons, 0.1) for photons in (620, 10_000)]
    cases += [(plain, "background 10:1", photons, 10.0) for photons in (100, 200, 620)]
    for number, (calibration, what, photons, ratio) in enumerate(cases):
        mean = np.ones((*size, 1)) * expected(DEPTH_M, amplitudes(WHITE, photons), ratio * photons)
        image = hf.reconstruct(drawn(mean, np.random.default_rng([2, number])), calibration)
        seen = image["quality"].values == 0
        inside = np.abs(image["depth"].values - DEPTH_M) < image["depth_std"].values
        cover = inside[seen].mean()
        yield Row(
            f"{what}, {photons} photons: 68 % interval of unflagged depths covers",
            f"{cover:.1%}", "64-72 %", "66-70 %", bool(0.64 <= cover <= 0.72),
        )  # fmt: skip
