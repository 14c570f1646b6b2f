# SPDX-License-Identifier: Apache-2.0
"""One image of a simulated scene, small but with everything in it."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import hueflight as hf
from hueflight.analysis import stack
from hueflight.export import describe
from hueflight.simulator import scene, simulate_capture

ROWS, COLS = 20, 14


@pytest.fixture(scope="session")
def camera() -> hf.Instrument:
    """The paper's instrument with fewer, larger pixels: the same field of view."""
    instrument = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(
        instrument.sensor,
        rows=ROWS,
        cols=COLS,
        pixel_width_um=18.4 * 128 / COLS,
        pixel_height_um=9.2 * 192 / ROWS,
    )
    return instrument.replace(sensor=sensor)


@pytest.fixture(scope="session")
def counts(camera: hf.Instrument) -> NDArray[np.unsignedinteger]:
    return simulate_capture(
        "scene", camera, frames=2000, scene=scene("colorchecker", camera), seed=1
    )


@pytest.fixture(scope="session")
def calibration(camera: hf.Instrument) -> hf.Calibration:
    reference = simulate_capture("reference", camera, frames=20000, seed=2)
    return hf.calibrate(reference, camera, distance=0.40)


@pytest.fixture(scope="session")
def image(counts: NDArray[np.unsignedinteger], calibration: hf.Calibration) -> xr.Dataset:
    """Described, with a few pixels that hold nothing."""
    found = describe(hf.reconstruct(counts, calibration), calibration, recording="test.mcap")
    hole = np.zeros((ROWS, COLS), dtype=bool)
    hole[3, 4:6] = True
    for name in found.data_vars:
        if found[name].dtype.kind == "f" and name != "photons":
            found[name] = found[name].where(~xr.DataArray(hole, dims=("row", "col")))
    found["quality"] = found["quality"].copy(
        data=found["quality"].values | np.where(hole, 4, 0).astype(np.uint16)
    )
    assert np.isfinite(found["depth"]).sum() > 200
    return found


@pytest.fixture(scope="session")
def series(image: xr.Dataset) -> xr.Dataset:
    """Three captures that differ."""

    def brighter(factor: float) -> xr.Dataset:
        return image.assign(reflectance=image["reflectance"] * np.float32(factor))

    return stack([image, brighter(1.5), brighter(0.5)], names=["a", "b", "c"], time=[0.0, 1.0, 2.5])


@pytest.fixture(scope="session")
def same() -> Callable[[NDArray[np.generic], NDArray[np.generic]], None]:
    """Equal number by number and in type, NaN where the other is NaN."""

    def check(found: NDArray[np.generic], wanted: NDArray[np.generic]) -> None:
        assert found.dtype == wanted.dtype
        np.testing.assert_array_equal(found, wanted)

    return check
