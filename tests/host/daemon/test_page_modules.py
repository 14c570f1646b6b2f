# SPDX-License-Identifier: Apache-2.0
"""What the page computes itself, run in Node: values of pixels, means of regions, distances."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[3] / "host/hueflight/daemon/page"
ROWS, COLS = 6, 5
UNKNOWN = 65535
COMPUTE = """
import { readFileSync } from "node:fs";
import { distanceOf, measureRegion } from "./measure.js";
import { brightnessOf, depthOf, depthStdOf, flagsOf, placeOf } from "./values.js";
const { picture, instrument, region, ends } = JSON.parse(readFileSync("given.json"));
const size = picture.rows * picture.cols;
const all = (value) => Array.from({ length: size }, (_, i) => value(picture, i));
console.log(JSON.stringify({
  depth: all(depthOf), std: all(depthStdOf), brightness: all(brightnessOf),
  flags: all((p, i) => flagsOf(p, i, { dead: 1, skipped: 32, misfit: 256 })),
  places: all((p, i) => placeOf(p, i, instrument)),
  region: measureRegion(picture, region, 2),
  distance: distanceOf(picture, instrument, ends),
}));
"""


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, Any]]:
    """What was given, and what the page makes of it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("the page's modules are run with Node, which is not installed")
    rng = np.random.default_rng(6)
    size = ROWS * COLS
    depth = rng.integers(8000, 12000, size)
    depth[7] = UNKNOWN
    std = rng.integers(50, 300, size)
    std[7] = UNKNOWN
    planes = {
        "depth": depth.tolist(),
        "depth_std": std.tolist(),
        "photons": rng.integers(0, 900, size).tolist(),
        "frames": rng.integers(100, 1000, size).tolist(),
        "bands": rng.integers(0, 256, 2 * size).tolist(),
        "quality": rng.choice([0, 1, 32, 33, 256], size).tolist(),
    }
    given = {
        "picture": {
            "rows": ROWS, "cols": COLS, "frames": 9, "depth_scale": 1e-4, "depth_std_scale": 1e-5,
            "tops": [0.8, 0.4], "planes": planes,
        },
        "instrument": {"slope_right": 0.3, "slope_down": 0.2},
        "region": [1, 1, 3, 4],
        "ends": [[0, 0], [5, 4]],
    }  # fmt: skip
    folder = tmp_path_factory.mktemp("page")
    (folder / "package.json").write_text('{"type": "module"}')
    for name in ("measure.js", "values.js", "state.js", "dom.js"):
        (folder / name).write_bytes((PAGE / name).read_bytes())
    (folder / "given.json").write_text(json.dumps(given))
    (folder / "compute.js").write_text(COMPUTE)
    done = subprocess.run(
        [node, "compute.js"], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return given, json.loads(done.stdout)


def values(given: dict[str, Any], name: str, scale: float) -> np.ndarray:
    plane = np.array(given["picture"]["planes"][name], float)
    return np.where(plane == UNKNOWN, np.nan, plane * scale)


def test_values_of_pixels(computed: Any) -> None:
    given, found = computed
    planes = given["picture"]["planes"]
    wanted = {
        "depth": values(given, "depth", 1e-4),
        "std": values(given, "depth_std", 1e-5),
        "brightness": np.array(planes["photons"]) / np.array(planes["frames"]),
    }
    for name, expected in wanted.items():
        got = np.array([np.nan if v is None else v for v in found[name]])
        np.testing.assert_allclose(got, expected, rtol=1e-12)
    names = {0: [], 1: ["dead"], 32: [], 33: ["dead"], 256: ["misfit"]}
    assert found["flags"] == [names[value] for value in planes["quality"]]


def places(given: dict[str, Any]) -> np.ndarray:
    """Positions, (pixel, 3): the rays spread evenly from edge to edge."""
    right, down = np.meshgrid(np.linspace(-0.3, 0.3, COLS), np.linspace(-0.2, 0.2, ROWS))
    rays = np.stack([right, down, np.ones_like(right)], axis=-1).reshape(-1, 3)
    return rays * values(given, "depth", 1e-4)[:, None]


def test_places_and_their_distance(computed: Any) -> None:
    given, found = computed
    wanted = places(given)
    known = np.isfinite(wanted).all(axis=1)
    got = np.array([[np.nan if v is None else v for v in place] for place in found["places"]])
    np.testing.assert_allclose(got[known], wanted[known], rtol=1e-12, atol=1e-12)
    first, last = wanted[0], wanted[-1]
    assert found["distance"]["distance"] == pytest.approx(np.linalg.norm(last - first))
    # the uncertainty, by moving each end along its ray
    variance = 0.0
    for index, other in ((0, last), (ROWS * COLS - 1, first)):
        depth, std = values(given, "depth", 1e-4)[index], values(given, "depth_std", 1e-5)[index]
        moved = wanted[index] * (depth + 1e-6) / depth
        gap = np.linalg.norm(moved - other) - np.linalg.norm(wanted[index] - other)
        variance += (gap / 1e-6 * std) ** 2
    assert found["distance"]["std"] == pytest.approx(np.sqrt(variance), rel=1e-4)


def test_the_mean_of_a_region(computed: Any) -> None:
    given, found = computed
    row, col, rows, cols = given["region"]
    part = (slice(row, row + rows), slice(col, col + cols))
    depth = values(given, "depth", 1e-4).reshape(ROWS, COLS)[part].ravel()
    std = values(given, "depth_std", 1e-5).reshape(ROWS, COLS)[part].ravel()
    known = np.isfinite(depth)
    depth, weights = depth[known], std[known] ** -2.0
    mean = np.average(depth, weights=weights)
    got = found["region"]["depth"]
    assert got["n"] == known.sum() == rows * cols - 1  # pixel 7 is unknown
    assert got["mean"] == pytest.approx(mean)
    assert got["scatter"] == pytest.approx(np.sqrt(((depth - mean) ** 2).sum() / (depth.size - 1)))
    # with equal weights this is the scatter divided by the root of the number
    spread = (weights**2 * (depth - mean) ** 2).sum() * depth.size / (depth.size - 1)
    assert got["error"] == pytest.approx(np.sqrt(spread) / weights.sum())
    for band, top in enumerate(given["picture"]["tops"]):
        plane = np.array(given["picture"]["planes"]["bands"]).reshape(2, ROWS, COLS)[band]
        light = top * (plane[part].ravel()[known] / 255) ** 2
        assert found["region"]["spectrum"][band]["mean"] == pytest.approx(light.mean())
        error = light.std(ddof=1) / np.sqrt(light.size)
        assert found["region"]["spectrum"][band]["error"] == pytest.approx(error)
