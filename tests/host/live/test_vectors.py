# SPDX-License-Identifier: Apache-2.0
"""The golden vectors of picture messages, read in Python and by the live page's own module."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hueflight.live import (
    Message,
    MessageError,
    Plane,
    VersionError,
    decode_message,
    encode_message,
    picture_of_message,
)

ROOT = Path(__file__).resolve().parents[3]
VECTORS = Path(__file__).parent / "vectors"
NAMES = sorted(path.stem for path in VECTORS.glob("*.bin"))
MODULE = ROOT / "host/hueflight/daemon/page/message.js"
READER = """
import { readFileSync } from "node:fs";
import { decodePicture } from "./message.mjs";
const file = readFileSync(process.argv[2]);
const bytes = file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength);
const { planes, ...header } = decodePicture(bytes);
const values = {};
for (const [name, plane] of Object.entries(planes)) {
  values[name] = { type: plane.constructor.name, values: Array.from(plane) };
}
console.log(JSON.stringify({ header, values }));
"""
ARRAYS = {
    "uint8": "Uint8Array",
    "uint16": "Uint16Array",
    "uint32": "Uint32Array",
    "float32": "Float32Array",
    "float64": "Float64Array",
}


def expected(name: str) -> Any:
    return json.loads((VECTORS / f"{name}.json").read_text())


def listed(values: np.ndarray) -> list[Any]:
    return [None if value != value else value for value in values.ravel().tolist()]


def test_there_are_vectors_of_both_codings() -> None:
    assert {expected(name)["header"]["coding"] for name in NAMES} == {"exact", "display"}


def test_the_vectors_are_those_of_the_generator() -> None:
    command = [sys.executable, str(ROOT / "tools" / "picture_vectors.py"), "--check"]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stdout + finished.stderr


@pytest.mark.parametrize("name", NAMES)
def test_python_reads_the_vectors(name: str) -> None:
    message, wanted = decode_message((VECTORS / f"{name}.bin").read_bytes()), expected(name)
    assert message.header == wanted["header"]
    found = {
        plane.name: {
            "type": plane.values.dtype.name,
            "dims": list(plane.dims),
            "shape": list(plane.values.shape),
            "values": listed(plane.values),
        }
        for plane in message.planes.values()
    }
    assert found == wanted["planes"]


@pytest.mark.parametrize("name", NAMES)
def test_the_page_reads_the_vectors(name: str, tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    (tmp_path / "message.mjs").write_bytes(MODULE.read_bytes())
    (tmp_path / "reader.mjs").write_text(READER)
    command = [node, str(tmp_path / "reader.mjs"), str(VECTORS / f"{name}.bin")]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr
    found, wanted = json.loads(finished.stdout), expected(name)
    assert found["header"] == {"version": 1, **wanted["header"]}
    assert found["values"] == {
        plane: {"type": ARRAYS[facts["type"]], "values": facts["values"]}
        for plane, facts in wanted["planes"].items()
    }


def test_an_exact_vector_is_an_image() -> None:
    image = picture_of_message(decode_message((VECTORS / "exact.bin").read_bytes()))
    assert dict(image.sizes) == {"row": 2, "col": 3, "band": 2}
    assert image.band_name.values.tolist() == ["blue", "green"]
    assert image.sel(band="green").wavelength.item() == image.wavelength.values[1]
    assert image.wavelength.values.tolist() == [450.0, 532.5]
    assert image.depth.attrs["units"] == "m"
    assert (image.attrs["method"], image.attrs["number"]) == ("joint", 7)
    assert image.quality.values.tolist() == [[0, 64, 256], [512, 1, 0]]


def test_a_display_message_is_no_image() -> None:
    with pytest.raises(MessageError, match="'display': ask the daemon for 'exact'"):
        picture_of_message(decode_message((VECTORS / "display.bin").read_bytes()))


def test_planes_that_do_not_fit_together_are_refused() -> None:
    planes = {
        name: Plane(name, np.zeros(size), ("row",)) for name, size in (("depth", 2), ("photons", 3))
    }
    with pytest.raises(MessageError, match="do not fit together"):
        picture_of_message(Message({"coding": "exact"}, planes))


@pytest.mark.parametrize("size", [0, 3, 4, 100, -8, -1])
def test_a_message_cut_short_is_refused(size: int) -> None:
    message = (VECTORS / "exact.bin").read_bytes()
    with pytest.raises(MessageError, match=r"cut short|beyond the end"):
        decode_message(message[:size])


def test_damaged_headers_are_refused_without_other_errors() -> None:
    """Seeded damage: whatever stands in the header, only a MessageError comes of it."""
    rng = np.random.default_rng(1)
    whole = (VECTORS / "exact.bin").read_bytes()
    size = 4 + int.from_bytes(whole[:4], "little")
    refused = 0
    for _ in range(400):
        message = bytearray(whole)
        for place in rng.integers(0, size, rng.integers(1, 4)):
            message[place] = rng.integers(0, 256)
        try:
            decode_message(bytes(message))
        except MessageError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize("shape", [[], [-1], [2**62, 4], [2, 2]])
def test_shapes_that_do_not_fit_are_refused(shape: list[int]) -> None:
    message = encode_message({}, [Plane("x", np.zeros(4, np.uint8), ("row",))])
    size = int.from_bytes(message[:4], "little")
    text = message[4 : 4 + size].replace(b'"shape":[4]', f'"shape":{shape}'.encode())
    with pytest.raises(MessageError, match="'x'"):
        decode_message(len(text).to_bytes(4, "little") + text + message[4 + size :])


def test_another_version_is_told_from_damage() -> None:
    message = (VECTORS / "exact.bin").read_bytes().replace(b'"version":1', b'"version":2')
    with pytest.raises(VersionError, match="version 2, this software reads version 1"):
        decode_message(message)


def test_types_that_javascript_lacks_are_refused() -> None:
    with pytest.raises(MessageError, match="int64: convert it to one of uint8"):
        encode_message({}, [Plane("counts", np.zeros(3, np.int64), ("row",))])


def test_values_of_another_byte_order_are_sent_as_little_endian() -> None:
    values = np.array([1, 2], ">u2")
    assert encode_message({}, [Plane("x", values, ("row",))]).endswith(b"\1\0\2\0\0\0\0\0")
