# SPDX-License-Identifier: Apache-2.0
"""Golden vectors of picture messages, in both codings, for readers in any language.

Each vector is a message, NAME.bin, and what a reader must find in it, NAME.json: the header, and
for each plane its dimensions, type, shape and values (null for NaN, which JSON does not hold). The
expected values of exact messages come from the image, not from a reader. Run without arguments to
write them, with --check to compare them with what is there.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from hueflight.live import Plane, encode_message, message_of_image

FOLDER = Path(__file__).resolve().parents[1] / "tests" / "host" / "live" / "vectors"
HEADER = {
    "number": 7, "kind": "scene", "frames": 480, "device_s": 12.5,
    "received_unix_s": 1706745599.25, "made_ms": 31.25, "rows": 2, "cols": 3,
}  # fmt: skip
PIXELS = ("row", "col")


def image() -> xr.Dataset:
    """Return an image of 2 × 3 pixels and two bands, with unknown values and flags."""
    nan = np.nan
    depth = np.array([[0.4, nan, 1.25], [2.0, 0.125, 3.5]], np.float32)
    reflectance = np.arange(12, dtype=np.float32).reshape(2, 3, 2) / 16
    reflectance[0, 1] = nan
    return xr.Dataset(
        {
            "depth": (PIXELS, depth, {"units": "m"}),
            "depth_std": (PIXELS, depth / 64, {"units": "m"}),
            "reflectance": ((*PIXELS, "band"), reflectance, {"units": "1"}),
            "photons": (PIXELS, np.array([[1, 0, 70000], [3, 4, 5]], np.float32)),
            "quality": (PIXELS, np.array([[0, 64, 256], [512, 1, 0]], np.uint16)),
        },
        coords={
            "wavelength": ("band", np.array([450.0, 532.5]), {"units": "nm"}),
            "band_name": ("band", ["blue", "green"]),
        },
        attrs={"method": "joint", "reference_distance_m": 0.4},
    )


def display_planes() -> list[Plane]:
    """Return planes as the live page is sent them."""
    return [
        Plane("photons", np.array([[1, 0, 65535], [3, 4, 5]], np.uint16), PIXELS),
        Plane("depth", np.array([[0, 65535, 65534], [1, 2, 3]], np.uint16), PIXELS),
        Plane("bands", np.arange(12, dtype=np.uint8).reshape(2, 2, 3), ("band", *PIXELS)),
        Plane("quality", np.array([[0, 64, 256], [512, 1, 0]], np.uint16), PIXELS),
    ]


def listed(values: np.ndarray) -> list[float | int | None]:
    """Return the values in the order of memory; None for NaN."""
    return [None if value != value else value for value in values.ravel().tolist()]


def expected(header: dict[str, Any], planes: list[Plane]) -> dict[str, Any]:
    """Return what a reader must find."""
    return {
        "header": header,
        "planes": {
            plane.name: {
                "type": plane.values.dtype.name,
                "dims": list(plane.dims),
                "shape": list(plane.values.shape),
                "values": listed(plane.values),
            }
            for plane in planes
        },
    }


def vectors() -> dict[str, bytes]:
    """Return the files of all vectors by name."""
    found = image()
    planes = [
        Plane(str(name), found[name].values, tuple(map(str, found[name].dims)))
        for name in found.variables
        if name != "band_name"
    ]
    exact = {**HEADER, "coding": "exact", "attrs": found.attrs, "band_names": ["blue", "green"]}
    shown = {**HEADER, "coding": "display", "depth_scale": 0.25, "tops": [0.5, 1.0]}
    alone = {**HEADER, "coding": "exact", "attrs": {}}
    photons = np.array([[1, 0, 4294967295], [3, 4, 5]], np.uint32)
    made = {
        "exact": (message_of_image(found, HEADER), expected(exact, planes)),
        "exact-photons": (
            message_of_image(xr.Dataset({"photons": (PIXELS, photons)}), HEADER),
            expected(alone, [Plane("photons", photons, PIXELS)]),
        ),
        "display": (encode_message(shown, display_planes()), expected(shown, display_planes())),
    }
    files = {}
    for name, (message, content) in made.items():
        files[f"{name}.bin"] = message
        files[f"{name}.json"] = (json.dumps(content, indent=1) + "\n").encode()
    return files


def main() -> int:
    """Write the vectors or compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    arguments = parser.parse_args()
    files = vectors()
    if not arguments.check:
        FOLDER.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (FOLDER / name).write_bytes(content)
        return 0
    differing = [
        name
        for name, content in files.items()
        if not (FOLDER / name).exists() or (FOLDER / name).read_bytes() != content
    ]
    print("differing:", ", ".join(differing) or "none")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
