# SPDX-License-Identifier: Apache-2.0
"""Images of known truth with known Gaussian noise."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hueflight as hf

ROWS, COLS = 40, 50
WAVELENGTHS = hf.Instrument.load("paper").wavelengths_nm


@pytest.fixture(scope="session")
def noisy() -> Callable[..., xr.Dataset]:
    """Function that draws an image: depth and reflectance may vary by pixel."""

    def draw(
        *,
        depth: Any = 1.0,
        reflectance: Any = 0.5,
        depth_std: float = 0.02,
        reflectance_std: float = 0.05,
        seed: int = 0,
        rows: int = ROWS,
        cols: int = COLS,
    ) -> xr.Dataset:
        rng = np.random.default_rng(seed)
        bands = WAVELENGTHS.size
        z = np.broadcast_to(depth, (rows, cols)) + depth_std * rng.normal(size=(rows, cols))
        colour = np.broadcast_to(reflectance, (rows, cols, bands))
        colour = colour + reflectance_std * rng.normal(size=colour.shape)
        plane, cube = ("row", "col"), ("row", "col", "band")
        return xr.Dataset(
            {
                "depth": (plane, z, {"units": "m"}),
                "depth_std": (plane, np.full_like(z, depth_std), {"units": "m"}),
                "reflectance": (cube, colour, {"units": "1"}),
                "reflectance_std": (cube, np.full_like(colour, reflectance_std)),
                "quality": (plane, np.zeros((rows, cols), np.uint16)),
            },
            coords={"wavelength": ("band", WAVELENGTHS, {"units": "nm"})},
            attrs={
                "instrument": "paper",
                "instrument_fingerprint": "f",
                "reference_distance_m": 0.4,
            },
        )

    return draw
