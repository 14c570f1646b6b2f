# SPDX-License-Identifier: Apache-2.0
"""Colours that the page gives to pixels, and how often it changes what is around, run in Node."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

PAGE = Path(__file__).resolve().parents[3] / "host/hueflight/daemon/page"
ROWS, COLS = 7, 9
UNKNOWN = 65535
UNKNOWN_COLOR = (19, 22, 26)
TINT = (0.2, 0.9, 0.5)
LIMIT = 100.0  #: standard deviation of depth, in units of its plane
SHADE = """
import { readFileSync } from "node:fs";
import { shade, shadeFlags, tonesOf } from "./shading.js";
const { picture, views, tint, flags } = JSON.parse(readFileSync("given.json"));
const size = picture.rows * picture.cols;
picture.planes.bands = Uint8Array.from(picture.planes.bands);
const colour = (_, i) => 0xff000000 + (255 - i) * 65536 + 7 * 256 + i;
const map = Uint32Array.from({ length: 256 }, colour);
const out = new Uint32Array(size);
const found = views.map((view) => {
  shade(out, picture, { ...view, map, tones: tonesOf(tint) });
  return Array.from(new Uint8Array(out.slice().buffer));
});
shadeFlags(out, picture.planes.quality, flags);
console.log(JSON.stringify({ views: found, flagged: Array.from(out, (v) => v === 0xffffffff) }));
"""
PACE = """
import { paced } from "./pace.js";
let now = 1000, waiting = [];
globalThis.performance = { now: () => now };
globalThis.setTimeout = (action, ms) => waiting.push([now + ms, action]);
const done = [];
const call = paced(() => done.push(now), 200);
for (; now < 2000; now += 10) {
  const due = waiting.filter(([at]) => at <= now);
  waiting = waiting.filter(([at]) => at > now);
  for (const [, action] of due) action();
  if (now < 1500 || now === 1900) call();
}
console.log(JSON.stringify(done));
"""
CHANGE = """
import { setShown, setText } from "./dom.js";
const writes = [];
const element = new Proxy({ hidden: true, textContent: "" }, {
  set: (target, name, value) => writes.push([name, value]) && Reflect.set(target, name, value),
});
for (const shown of [undefined, "", true, "live", null, null]) setShown(element, shown);
for (const text of ["", "live", "live", "idle"]) setText(element, text);
console.log(JSON.stringify(writes));
"""
OPTIONS = {
    "range": [9000, 11000], "logarithmic": False, "three": False, "rgb": [1, 0, 1],
    "limit": 0, "band": 1,
}  # fmt: skip
VIEWS: dict[str, dict[str, Any]] = {
    "depth": {"view": "depth"},
    "faded": {"view": "depth", "limit": LIMIT},
    "photons": {"view": "photons", "range": [0.2, 1.5], "limit": LIMIT},
    "logarithmic": {"view": "photons", "range": [0.02, 1.5], "logarithmic": True},
    "colour": {"view": "colour"},
    "three bands": {"view": "colour", "three": True},
    "band": {"view": "bands", "limit": LIMIT},
}


def run_in_node(folder: Path, program: str, *modules: str) -> Any:
    """What a program that imports modules of the page prints as JSON."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("the page's modules are run with Node, which is not installed")
    (folder / "package.json").write_text('{"type": "module"}')
    for name in modules:
        (folder / name).write_bytes((PAGE / name).read_bytes())
    (folder / "program.js").write_text(program)
    done = subprocess.run(
        [node, "program.js"], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def shaded(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, Any]]:
    """The planes of a picture, and the colors of its pixels, (pixel, RGBA), by view."""
    rng = np.random.default_rng(3)
    size = ROWS * COLS
    depth = rng.integers(8500, 11500, size)
    depth[::8] = UNKNOWN
    planes = {
        "depth": depth,
        "depth_std": np.geomspace(LIMIT / 5, LIMIT * 5, size).astype(int),
        "photons": rng.integers(0, 900, size),
        "frames": rng.integers(0, 1000, size),
        "bands": rng.integers(0, 256, 2 * size),
        "colours": rng.integers(0, 256, 3 * size),
        "quality": rng.choice([0, 1, 32, 33, 256], size),
    }
    picture = {"rows": ROWS, "cols": COLS, "planes": {k: v.tolist() for k, v in planes.items()}}
    given = {
        "picture": picture, "views": [{**OPTIONS, **view} for view in VIEWS.values()],
        "tint": TINT, "flags": 32,
    }  # fmt: skip
    folder = tmp_path_factory.mktemp("shading")
    (folder / "given.json").write_text(json.dumps(given))
    found = run_in_node(folder, SHADE, "shading.js", "values.js")
    views = {
        name: np.array(pixels).reshape(size, 4)
        for name, pixels in zip(VIEWS, found["views"], strict=True)
    }
    return planes, {"views": views, "flagged": np.array(found["flagged"])}


def mapped(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.floating]:
    """Colours of values by the map of the program above."""
    place = np.floor(np.clip((values - low) / (high - low), 0, 1) * 255 + 0.5)
    return np.stack([place, np.full_like(place, 7), 255 - place], axis=-1)


def expected(planes: dict[str, Any]) -> dict[str, NDArray[np.floating]]:
    """Colours of all pixels, (pixel, RGB), by view."""
    each = planes["photons"] / np.maximum(1, planes["frames"])
    bands = planes["bands"].reshape(2, -1)
    depth = mapped(planes["depth"].astype(float), 9000, 11000)
    depth[planes["depth"] == UNKNOWN] = UNKNOWN_COLOR
    # as they are up to half the limit, gone from twice the limit on, by doublings in between
    left = np.clip(0.5 - 0.5 * np.log2(planes["depth_std"] / LIMIT), 0, 1)[:, None]
    value = bands[1][:, None] / 255
    white = np.clip(2 * value - 1, 0, 1)
    return {
        "depth": depth,
        "faded": left * depth + (1 - left) * np.array(UNKNOWN_COLOR),
        "photons": mapped(each, 0.2, 1.5),
        "logarithmic": mapped(np.log(np.maximum(each, 1e-9)), np.log(0.02), np.log(1.5)),
        "colour": planes["colours"].reshape(-1, 3),
        "three bands": bands[[1, 0, 1]].T,
        "band": 255 * (np.array(TINT) * (1 - white) + white) * np.minimum(1, 1.6 * value),
    }


@pytest.mark.parametrize("view", VIEWS)
def test_colors_of_pixels(shaded: Any, view: str) -> None:
    planes, found = shaded
    assert (found["views"][view][:, 3] == 255).all()
    np.testing.assert_allclose(found["views"][view][:, :3], expected(planes)[view], atol=1.0)
    assert len(np.unique(found["views"][view], axis=0)) > 20


def test_flagged_pixels(shaded: Any) -> None:
    planes, found = shaded
    assert (found["flagged"] == ((planes["quality"] & 32) != 0)).all()


def test_pictures_are_followed_at_once_and_then_at_intervals(tmp_path: Path) -> None:
    """The last of many calls counts too, and a call after a pause acts without delay."""
    assert run_in_node(tmp_path, PACE, "pace.js") == [1000, 1200, 1400, 1600, 1900]


def test_elements_are_changed_only_where_they_differ(tmp_path: Path) -> None:
    assert run_in_node(tmp_path, CHANGE, "dom.js") == [
        ["hidden", False], ["hidden", True], ["textContent", "live"], ["textContent", "idle"],
    ]  # fmt: skip
