# SPDX-License-Identifier: Apache-2.0
"""A few captures of a small camera, with its calibration, in a folder."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight.importers.captures import write_counts

ROWS, COLS = 10, 8


@pytest.fixture(scope="session")
def camera(small: Callable[..., hf.Instrument]) -> hf.Instrument:
    return small(rows=ROWS, cols=COLS)


@pytest.fixture(scope="session")
def calibration(camera: hf.Instrument, draw: Callable[..., np.ndarray]) -> hf.Calibration:
    return hf.calibrate(draw(camera, depth=0.4, photons=20_000), camera, distance=0.4)


@pytest.fixture
def captures(camera: hf.Instrument, draw: Callable[..., np.ndarray], tmp_path: Path) -> list[Path]:
    """Five captures at different distances."""
    paths = [tmp_path / f"run{number}.npz" for number in range(5)]
    for number, path in enumerate(paths):
        write_counts(path, draw(camera, depth=0.5 + 0.1 * number, seed=number), camera)
    return paths
