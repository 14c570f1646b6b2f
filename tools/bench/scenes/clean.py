# SPDX-License-Identifier: Apache-2.0
"""Scenes that obey the model: the reference for everything that does not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from acceptance import Row
from outside_model import COLORS, amplitudes, bound_m, calibrated, drawn, expected

import hueflight as hf

DEPTH_M = 1.3
PICTURES = 4  #: of 6144 pixels each: coverage is then known to 0.3 %


def rows(quick: bool) -> Iterator[Row]:
    """Error against the bound and coverage of the joint fit, for 620 photons."""
    size = (32, 32) if quick else (96, 64)
    calibration = calibrated(*size)
    for number, (name, reflectance) in enumerate(COLORS.items()):
        light = amplitudes(reflectance, 620)
        mean = np.ones((*size, 1)) * expected(DEPTH_M, light, 62)
        images = [
            hf.reconstruct(drawn(mean, np.random.default_rng([1, number, picture])), calibration)
            for picture in range(1 if quick else PICTURES)
        ]
        error = np.array([image["depth"].values - DEPTH_M for image in images])
        ratio = np.sqrt(np.mean(error**2)) / bound_m(DEPTH_M, light, 62)
        cover = (np.abs(error) < [image["depth_std"].values for image in images]).mean()
        # the standard error of the ratio is 1/sqrt(2 n), 0.5 % of 24 576 pixels
        yield Row(
            f"clean scene, {name}, 620 photons: RMSE ÷ bound",
            f"{ratio:.3f}", "≤ 1.1", "1", bool(ratio <= 1.1),
        )  # fmt: skip
        yield Row(
            f"clean scene, {name}, 620 photons: 68 % interval covers",
            f"{cover:.1%}", "66-70 %", "68.3 %", bool(0.66 <= cover <= 0.70),
        )  # fmt: skip
