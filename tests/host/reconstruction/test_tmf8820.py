# SPDX-License-Identifier: Apache-2.0
"""The same calibrate and reconstruct on a real sensor: a plane moved by a robot arm.

ams TMF8820, 80 captures at known distances; each carries the sensor's own reference pulse.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf

NEAREST = 0.05  # metres; closer, the plane's light runs into the sensor's cover glass


@pytest.fixture(scope="module")
def instrument():
    return hf.Instrument.load(Path(__file__).parent.parent / "data" / "tmf8820.toml")


@pytest.fixture(scope="module")
def captures(real_data):
    text = (real_data / "tmf8820" / "plane_distances.json").read_text()
    return [c for c in json.loads(text) if c["dist_to_plane"] > NEAREST]


def residual_cm(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """RMSE in cm of each zone after an affine fit; found (capture, zone)."""
    line = np.stack([truth, np.ones_like(truth)], axis=1)
    fitted, *_ = np.linalg.lstsq(line, found, rcond=None)
    scale = fitted[0]  # in metres of the robot's, not of the sensor's
    return 100 * np.sqrt(((found - line @ fitted) ** 2).mean(axis=0)) / scale


def depths(captures, instrument, method: str) -> np.ndarray:
    found = []
    for capture in captures:
        reference = np.tile(np.array(capture["reference_hist"]), (3, 3, 1))
        calibration = hf.calibrate(reference, instrument, distance=0.0)
        histogram = np.array(capture["hists"]).reshape(3, 3, 128)
        found.append(hf.reconstruct(histogram, calibration, method=method).depth.values.ravel())
    return np.array(found)


@pytest.mark.parametrize(("method", "limit_cm"), [("paper", 0.15), ("joint", 0.13)])
def test_every_zone_follows_the_robot(captures, instrument, method, limit_cm):
    truth = np.array([c["dist_to_plane"] for c in captures])
    found = residual_cm(truth, depths(captures, instrument, method))
    peak = residual_cm(truth, np.array([[np.argmax(z) for z in c["hists"]] for c in captures]))
    firmware = residual_cm(truth, np.array([c["distances"][0]["depths_1"] for c in captures]))
    for name, values in {method: found, "argmax": peak, "firmware": firmware}.items():
        print(f"{name:>9}: " + " ".join(f"{v:.3f}" for v in values) + " cm")
    assert found.max() <= limit_cm
    assert (found < 0.5 * peak).all()
