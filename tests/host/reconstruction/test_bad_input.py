# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import CalibrationError, HistogramError


@pytest.fixture(scope="module")
def instrument(small):
    return small(rows=6, cols=5)


@pytest.fixture(scope="module")
def calibration(instrument, draw):
    return hf.calibrate(draw(instrument), instrument, distance=0.5)


@pytest.mark.parametrize(
    ("shape", "advice"),
    [
        ((5, 6, 512), "transpose"),
        ((512, 6, 5), "transpose"),
        ((6, 5, 256), "number of codes differs"),
        ((192, 128, 512), "number of pixels differs"),
        ((512,), "belongs to this instrument"),
    ],
)
def test_shapes(calibration, shape, advice):
    with pytest.raises(HistogramError, match=r"\(row, col, code\) = \(6, 5, 512\)") as caught:
        hf.reconstruct(np.ones(shape, np.uint16), calibration)
    assert advice in str(caught.value)


def test_nothing_counted(calibration):
    with pytest.raises(HistogramError, match="is empty: not one frame"):
        hf.reconstruct(np.zeros((6, 5, 512), np.uint32), calibration)


@pytest.mark.parametrize(
    ("value", "message"),
    [(np.nan, r"\(1, 2, 3\)\] is nan"), (np.inf, "is inf"), (-1.0, "can't be negative")],
)
def test_values(calibration, draw, instrument, value, message):
    counts = draw(instrument).astype(float)
    counts[1, 2, 3] = value
    with pytest.raises(HistogramError, match=message):
        hf.reconstruct(counts, calibration)


@pytest.mark.parametrize("dtype", [complex, bool, "U4", object])
def test_types(calibration, draw, instrument, dtype):
    with pytest.raises(HistogramError, match="counts must be numbers"):
        hf.reconstruct(draw(instrument).astype(dtype), calibration)


def test_method(calibration, draw, instrument):
    with pytest.raises(HistogramError, match="method = 'best': choose one of"):
        hf.reconstruct(draw(instrument), calibration, method="best")


@pytest.mark.parametrize("frames", [0, -3, np.nan, np.inf])
def test_frames(calibration, draw, instrument, frames):
    with pytest.raises(HistogramError, match="must be above 0 and finite"):
        hf.reconstruct(draw(instrument), calibration, frames=frames)


@pytest.mark.parametrize("method", ["joint", "pooled", "paper", "sums"])
@pytest.mark.parametrize(("field", "value"), [("brightness", 0.0), ("gain", np.inf)])
def test_calibration_with_a_dark_band(calibration, draw, instrument, method, field, value):
    """Warnings are errors in tests, so that none of a division comes first."""
    values = getattr(calibration, field).copy()
    values[1] = value
    dark = replace(calibration, **{field: values})
    name = instrument.bands[1].name
    with pytest.raises(CalibrationError, match=rf"for band '{name}': its LED was dark"):
        hf.reconstruct(draw(instrument), dark, method=method)


def test_depth_range_in_millimeters(calibration, draw, instrument):
    with pytest.raises(hf.HueflightError, match="narrow it, and give it in meters"):
        hf.reconstruct(draw(instrument), calibration, depth_range=(200, 150_000))


def test_depth_range_of_a_single_shot_ends_with_its_bins():
    """Delays beyond the recorded time once met the pulse again, at a depth that looked right."""
    sensor = hf.Instrument.load(Path(__file__).parent.parent / "data" / "tmf8820.toml")
    places = np.arange(sensor.time_bins().count)

    def zones(middle: float) -> np.ndarray:
        pulse = 1e4 * np.exp(-((places - middle) ** 2) / 8) + 10
        return np.tile(np.rint(pulse).astype(np.uint32), (*sensor.image_shape, 1))

    made = hf.calibrate(zones(20), sensor, distance=0.0)
    plain = hf.reconstruct(zones(30), made).depth.values
    np.testing.assert_allclose(
        hf.reconstruct(zones(30), made, depth_range=(-1000, 1000)).depth.values, plain, atol=1e-4
    )
    with pytest.raises(hf.HueflightError, match=r"outside the .* ns that are recorded"):
        hf.reconstruct(zones(30), made, depth_range=(50, 51))
