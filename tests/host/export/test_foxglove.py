# SPDX-License-Identifier: Apache-2.0
"""Foxglove's message types, read by its own decoder of MCAP."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
pytest.importorskip("mcap_protobuf", reason="mcap-protobuf-support is not installed (extra dev)")

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import hueflight as hf
from hueflight.color import color_picture
from hueflight.errors import ExportError
from hueflight.export import image_points, write
from hueflight.export.description import band_labels
from hueflight.export.foxglove_messages import OPTICAL_ROTATION, camera_matrix
from hueflight.files.image_schema import captures

Messages = dict[str, list[tuple[int, Any]]]


def read(path: Path) -> tuple[Messages, dict[str, str]]:
    """Times and decoded messages by topic, and the schema of each topic."""
    messages: Messages = {}
    schemas: dict[str, str] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append((message.log_time, decoded))
            assert schema is not None
            assert schema.encoding == "protobuf"
            schemas[channel.topic] = schema.name
    return messages, schemas


@pytest.fixture(scope="module")
def written(image: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "scene.mcap"
    write(image, path)
    return path


def plane(message: Any) -> np.ndarray:
    kind = {"32FC1": "<f4", "mono16": "<u2", "rgb8": "u1"}[message.encoding]
    values = np.frombuffer(message.data, kind).reshape(message.height, -1)
    assert values.strides[0] == message.step
    return values.reshape(message.height, message.width, -1).squeeze()


def test_every_plane_and_band_is_a_topic_with_its_values(image: xr.Dataset, written: Path) -> None:
    messages, schemas = read(written)
    names = band_labels(image)
    for name, variable in image.data_vars.items():
        if "band" in variable.dims:
            for number, band in enumerate(names):
                [(_, found)] = messages[f"/{name}/{band}"]
                assert np.array_equal(
                    plane(found), variable.isel(band=number).values, equal_nan=True
                )
        else:
            [(_, found)] = messages[f"/{name}"]
            assert np.array_equal(plane(found), variable.values, equal_nan=True)
    [(_, color)] = messages["/color"]
    assert (plane(color) == np.rint(color_picture(image) * 255)).all()
    assert np.isnan(plane(messages["/depth"][0][1])).any()
    assert set(schemas.values()) == {
        "foxglove.RawImage", "foxglove.PointCloud", "foxglove.CameraCalibration",
        "foxglove.FrameTransforms", "foxglove.Log",
    }  # fmt: skip


def test_points_have_every_band_and_the_quality(image: xr.Dataset, written: Path) -> None:
    [(_, cloud)] = read(written)[0]["/points"]
    kinds = [None, "u1", "i1", "<u2", "<i2", "<u4", "<i4", "<f4", "<f8"]
    dtype = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [kinds[field.type] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_stride,
        }
    )
    found, wanted = np.frombuffer(cloud.data, dtype), image_points(image)
    assert len(found) == len(wanted.xyz) == np.isfinite(image.depth.values).sum()
    assert np.stack([found[c] for c in "xyz"], 1) == pytest.approx(wanted.xyz, rel=1e-6)
    assert np.array_equal(np.stack([found[c] for c in ("red", "green", "blue")], 1), wanted.rgb)
    for name, values in wanted.fields.items():
        assert np.array_equal(found[name], values, equal_nan=values.dtype.kind == "f")
    assert "quality" in wanted.fields
    assert cloud.frame_id == "camera_optical"


def test_the_calibration_projects_points_to_their_pixels(image: xr.Dataset, written: Path) -> None:
    [(_, stated)] = read(written)[0]["/calibration"]
    points = image_points(image)
    projected = points.xyz @ np.array(stated.K).reshape(3, 3).T
    found = projected[:, :2] / projected[:, 2:]
    wanted = np.stack([points.fields["col"], points.fields["row"]], axis=1)
    assert found == pytest.approx(wanted, abs=1e-6)
    assert np.array(stated.P).reshape(3, 4)[:, :3].ravel().tolist() == list(stated.K)
    assert (stated.height, stated.width) == image.depth.shape


def test_the_frames_are_those_of_robotics(written: Path) -> None:
    """REP 103: the optical axis z is x of the body, right x is -y, down y is -z."""
    [(_, frames)] = read(written)[0]["/tf"]
    [transform] = frames.transforms
    assert (transform.parent_frame_id, transform.child_frame_id) == ("camera", "camera_optical")
    x, y, z, w = OPTICAL_ROTATION
    r = transform.rotation
    assert (r.x, r.y, r.z, r.w) == OPTICAL_ROTATION
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert matrix.tolist() == [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]


def test_a_series_has_its_times(series: xr.Dataset, tmp_path: Path) -> None:
    write(series, tmp_path / "series.mcap")
    messages, _ = read(tmp_path / "series.mcap")
    assert [time for time, _ in messages["/depth"]] == [0, 1_000_000_000, 2_500_000_000]
    write(series.drop_vars("time"), tmp_path / "even.mcap", interval_s=0.5)
    messages, _ = read(tmp_path / "even.mcap")
    assert [time for time, _ in messages["/depth"]] == [0, 500_000_000, 1_000_000_000]
    stamp = messages["/depth"][1][1].timestamp
    assert (stamp.seconds, stamp.nanos) == (0, 500_000_000)
    band = band_labels(series)[0]
    for (_, found), single in zip(messages[f"/reflectance/{band}"], captures(series), strict=True):
        expected = single.reflectance.isel(band=0).values
        assert np.array_equal(plane(found), expected, equal_nan=True)


def test_a_picture_without_any_depth_has_no_points_and_a_warning(
    image: xr.Dataset, tmp_path: Path
) -> None:
    unknown = image.assign(depth=image.depth * np.float32(np.nan))
    write(unknown, tmp_path / "dark.mcap")
    messages, _ = read(tmp_path / "dark.mcap")
    assert messages["/points"][0][1].data == b""
    log = messages["/log"][0][1]
    assert log.message.startswith(f"0 of {image.depth.size} pixels have a depth")
    assert log.level == 3  # WARNING


def test_without_a_lens_the_camera_is_stated_as_uncalibrated(camera: hf.Instrument) -> None:
    assert (camera_matrix(camera.replace(lens=None)) == 0).all()


def test_an_interval_must_be_positive(image: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"interval_s = 0"):
        write(image, tmp_path / "x.mcap", interval_s=0)


def test_the_layout_is_what_the_builder_of_the_sdk_makes() -> None:
    """It shows topics that the export writes."""
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, str(root / "tools" / "foxglove_layout.py"), "--check"]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr
    shown = set(re.findall(r'"(/[a-z_]+)"', (root / "docs/foxglove-layout.json").read_text()))
    assert shown == {"/points", "/color", "/depth", "/depth_std", "/calibration", "/log"}
