# SPDX-License-Identifier: Apache-2.0
"""Arguments of wrong types at the public functions: one sentence each, of one family of errors."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hueflight as hf
from hueflight.errors import ArgumentError

TEXT, NOTHING, ROUGH, NEGATIVE, RAGGED = "text", None, 1.5, -1, [[1, [2]]]


@pytest.fixture(scope="module")
def made(small, draw) -> dict[str, Any]:
    """One of each: counts, instrument, calibration, image, design of sums."""
    instrument = small(rows=3, cols=4)
    counts = draw(instrument)
    calibration = hf.calibrate(counts, instrument, distance=0.5)
    return {
        "counts": counts,
        "instrument": instrument,
        "calibration": calibration,
        "image": hf.reconstruct(counts, calibration),
        "design": hf.design_sums(calibration),
        "path": "counts.npy",
    }


#: function, its right positional arguments, those named that it needs
FUNCTIONS: dict[str, tuple[Callable[..., Any], str, dict[str, Any]]] = {
    "calibrate": (hf.calibrate, "counts instrument", {"distance": 0.5}),
    "reconstruct": (hf.reconstruct, "counts calibration", {}),
    "reconstruct_packets": (hf.reconstruct_packets, "packets calibration", {}),
    "reconstruct_sums": (hf.reconstruct_sums, "counts design calibration", {}),
    "reconstruct_interleaved": (hf.reconstruct_interleaved, "list list", {}),
    "reconstruct_file": (hf.reconstruct_file, "path path", {"calibration": "c.zarr"}),
    "reconstruct_many": (hf.reconstruct_many, "list path", {"calibration": "c.zarr"}),
    "check_image": (hf.check_image, "counts calibration image", {}),
    "correct_drift": (hf.correct_drift, "counts calibration image", {}),
    "compare": (hf.compare, "image image", {}),
    "color_picture": (hf.color_picture, "image", {}),
    "depth_bound": (hf.depth_bound, "calibration", {"photons": 100}),
    "reflectance_bound": (hf.reflectance_bound, "calibration", {"photons": 100}),
    "reflectance_interval": (hf.reflectance_interval, "image", {}),
    "flag_mixed": (hf.flag_mixed, "image calibration", {}),
    "design_sums": (hf.design_sums, "calibration", {}),
    "open_recording": (hf.open_recording, "path", {}),
    "read_capture": (hf.read_capture, "path instrument", {}),
    "read_counts": (hf.read_counts, "path instrument", {}),
    "read_image": (hf.read_image, "path", {}),
    "write_counts": (hf.write_counts, "path counts instrument", {}),
    "write_image": (hf.write_image, "image path", {}),
    "load": (hf.Instrument.load, "path", {}),
}
#: what is wrong in place of each positional argument; "image" stands for one of xarray
WRONG: dict[str, tuple[Any, ...]] = {
    "counts": ("image", TEXT, Path("counts.npy"), NOTHING, RAGGED, {}),
    "instrument": ("image", "calibration", TEXT, Path("paper.toml"), 3),
    "calibration": ("image", TEXT, Path("my.zarr"), NOTHING, 3),
    "image": (TEXT, Path("image.zarr"), NOTHING, np.zeros((3, 4))),
    "design": (TEXT, NOTHING, "calibration"),
    "packets": (TEXT, NOTHING, 3),
    "path": (NOTHING, 3, "image", "", [1]),
    "list": (TEXT, NOTHING, 3),
}
#: options of wrong types or out of all range
OPTIONS: dict[str, dict[str, tuple[Any, ...]]] = {
    "calibrate": {
        "distance": (NOTHING, TEXT, [1, 2], True, "image"),
        "bands": (TEXT, "image", RAGGED),
        "reflectance": (TEXT, "image"),
        "dark": (TEXT, "image"),
        "flat": (TEXT, "image"),
        "frames": (TEXT, True, "image"),
        "emission": (TEXT, "calibration"),
    },
    "reconstruct": {
        "method": (NOTHING, 3, "image"),
        "depth_range": (TEXT, 3, (0.1, None), (0.1, 1, 2), (0.1, np.inf)),
        "frames": (TEXT, "image"),
        "range_correction": (TEXT, 1),
        "pileup_correction": (TEXT, NOTHING),
        "bands": ([1.5], [None], 3, {}),
        "threads": (ROUGH, NEGATIVE, 0, NOTHING, TEXT, True),
        "skips": (NOTHING, TEXT),
        "mixed": (TEXT, {}),
        "second_returns": (TEXT, 2),
    },
    "check_image": {"threads": (ROUGH, NEGATIVE), "pixels": (ROUGH, TEXT), "background": (TEXT,)},
    "correct_drift": {"threads": (ROUGH, NEGATIVE), "pixels": (ROUGH, TEXT)},
    "compare": {"false_discovery_rate": (TEXT, NOTHING)},
    "color_picture": {"instrument": (TEXT,), "emission": (TEXT,), "white": (TEXT,)},
    "depth_bound": {"photons": (TEXT, NOTHING), "background": (TEXT,), "reflectance": (TEXT,)},
    "reflectance_interval": {"level": (TEXT, NOTHING)},
    "flag_mixed": {"pixel_angle": (TEXT,)},
    "design_sums": {"sums": (ROUGH, TEXT), "entry_bits": (ROUGH, NOTHING), "depth_range": (3,)},
    "read_counts": {"channel": (ROUGH, TEXT), "axes": (3, NOTHING), "dataset": (3,)},
    "write_image": {"format": (3,), "overwrite": (TEXT,)},
    "reconstruct_many": {"workers": (ROUGH, TEXT)},
}
CASES = [
    (name, place, wrong)
    for name, (_, right, _) in FUNCTIONS.items()
    for place, kind in enumerate(right.split())
    for wrong in WRONG[kind]
] + [
    (name, option, wrong)
    for name, options in OPTIONS.items()
    for option, values in options.items()
    for wrong in values
]


@pytest.mark.parametrize(("name", "place", "wrong"), CASES)
def test_wrong_argument(made, name, place, wrong):
    function, right, needed = FUNCTIONS[name]
    if isinstance(wrong, str):
        wrong = made.get(wrong, wrong)
    rest = {"packets": b"", "list": []}
    given = [made.get(kind, rest.get(kind)) for kind in right.split()]
    named = dict(needed)
    if isinstance(place, int):
        given[place] = wrong
    else:
        named[place] = wrong
    with pytest.raises(ArgumentError, match=f"^{function.__name__}: .* it must be ") as caught:
        function(*given, **named)
    assert isinstance(caught.value, TypeError | ValueError)
    message = str(caught.value)
    assert len(message) < 200
    assert "\n" not in message


def test_numbers_of_numpy_are_numbers(made):
    image = hf.reconstruct(
        made["counts"],
        made["calibration"],
        depth_range=np.array([0.2, 0.8]),
        frames=np.uint32(1_000_000),
        bands=np.array([0, 2]),
        threads=np.int64(1),
        mixed=np.False_,
    )
    assert image.sizes["band"] == 2
    assert hf.depth_bound(made["calibration"], photons=np.array(100)) > 0


def test_python_says_what_is_missing(made):
    with pytest.raises(TypeError, match="calibration"):
        hf.reconstruct(made["counts"])  # pyright: ignore[reportCallIssue]
