# SPDX-License-Identifier: Apache-2.0
"""Patterns of light that are known, through noise, and images freed from them."""

import numpy as np
import pytest

from hueflight.analysis import flatten, illumination_pattern
from hueflight.errors import HueflightError
from hueflight.reconstruction.quality import Quality

ROWS, COLS = 40, 50


def beams(bands):
    """cos⁴ falloff of LEDs beside the axis, each elsewhere: (row, col, band), mean 1."""
    row, col = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    planes = []
    for band in range(bands):
        angle = 2 * np.pi * band / bands
        squared = (row - 0.4 * np.sin(angle)) ** 2 + (col - 0.4 * np.cos(angle)) ** 2
        planes.append(1 / (1 + 0.3 * squared) ** 2)
    pattern = np.stack(planes, axis=-1)
    return pattern / pattern.mean((0, 1))


def test_the_pattern_is_found_and_removed(noisy):
    true = beams(9)
    assert true.min() < 0.6  # so that it matters
    board = noisy(reflectance=0.8 * true, reflectance_std=0.05)
    board["quality"][3:6, 4] = int(Quality.HOT)
    board["reflectance"][3:6, 4] = 50.0
    pattern = illumination_pattern(board)
    # 15 terms from 2000 pixels of 6 %: 0.5 %; the form itself is met to 1 % by order 4
    assert np.sqrt(np.mean((pattern.values - true) ** 2)) < 0.012
    scene = noisy(reflectance=0.3 * true, reflectance_std=0.01, seed=1)
    flat = flatten(scene, pattern)
    mean = flat.reflectance.values.reshape(5, 8, 5, 10, 9).mean((1, 3))
    np.testing.assert_allclose(mean, 0.3, rtol=0.03)
    assert np.ptp(scene.reflectance.values.reshape(5, 8, 5, 10, 9).mean((1, 3))) > 0.1
    ratio = (scene.reflectance_std / flat.reflectance_std).transpose("row", "col", "band")
    np.testing.assert_allclose(ratio, pattern, rtol=1e-5)
    assert flat.reflectance.attrs["flat_field"] == "illumination pattern of each band"
    assert "flat_field" not in scene.reflectance.attrs
    with pytest.raises(HueflightError, match="flattened already"):
        flatten(flat, pattern)


def test_what_does_not_fit_is_refused(noisy):
    board = noisy(reflectance=0.8)
    pattern = illumination_pattern(board, order=0)
    np.testing.assert_allclose(pattern, 1, rtol=1e-6)
    with pytest.raises(HueflightError, match="same instrument"):
        flatten(board.isel(row=slice(10)), pattern)
    other = board.assign_coords(wavelength=board.wavelength + 1)
    with pytest.raises(HueflightError, match="same bands"):
        flatten(other, pattern)
    half = np.where(np.arange(COLS) < COLS // 2, 0.8, 0.0)[None, :, None]
    with pytest.raises(HueflightError, match="does not fill the picture"):
        illumination_pattern(noisy(reflectance=half, reflectance_std=0.01))
    with pytest.raises(HueflightError, match=r"order = 1\.5"):
        illumination_pattern(board, order=1.5)
    with pytest.raises(HueflightError, match="120 are needed"):
        illumination_pattern(board.isel(row=slice(10), col=slice(10)))
