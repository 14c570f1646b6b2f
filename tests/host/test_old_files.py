# SPDX-License-Identifier: Apache-2.0
"""Files that version 0.1.0 wrote still open, and hold the same numbers."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import hueflight as hf

FILES = Path(__file__).resolve().parents[1] / "data" / "0.1.0"
ROUNDING = 1e-9  #: of numbers written as decimal text


@pytest.fixture(scope="module")
def expected() -> dict[str, Any]:
    return json.loads((FILES / "expected.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the Zarr stores, which are kept zipped."""
    folder = tmp_path_factory.mktemp("0.1.0")
    for name in ("calibration.zarr", "image.zarr"):
        shutil.unpack_archive(FILES / f"{name}.zip", folder)
    return folder


def test_instrument(expected: dict[str, Any]) -> None:
    tiny = hf.Instrument.load(FILES / "tiny.toml")
    assert tiny.fingerprint() == expected["fingerprint"]
    assert tiny.histogram_shape == (4, 3, 128)
    assert tiny.bands[1].delays_ns == (60.0, 200.0)


def test_recording_in_two_segments(expected: dict[str, Any]) -> None:
    with hf.open_recording(FILES / "scene.mcap") as recording:
        facts = recording.info().as_dict()
        counts = recording.histogram()
        assert recording.instrument.fingerprint() == expected["fingerprint"]
    assert {name: facts[name] for name in expected["recording"]} == expected["recording"]
    assert facts["segments"] == 2
    assert counts.sum(axis=(0, 1)).tolist() == expected["counts_per_code"]


def test_counts(expected: dict[str, Any]) -> None:
    capture = hf.read_capture(FILES / "reference.npz")
    assert capture.instrument.fingerprint() == expected["fingerprint"]
    assert capture.counts.sum(axis=(0, 1)).tolist() == expected["reference_per_code"]


def test_calibration(expected: dict[str, Any], unpacked: Path) -> None:
    calibration = hf.Calibration.load(unpacked / "calibration.zarr")
    assert calibration.instrument.fingerprint() == expected["fingerprint"]
    assert calibration.distance == expected["calibration"]["distance"]
    for name in ("gain", "pixel_delay_ns"):
        np.testing.assert_allclose(
            getattr(calibration, name), expected["calibration"][name], rtol=ROUNDING
        )


def require_image(image: xr.Dataset, expected: dict[str, Any]) -> None:
    assert image.attrs["instrument_fingerprint"] == expected["fingerprint"]
    assert image.attrs["capture"] == "scene.mcap"
    assert image["wavelength"].values.tolist() == expected["wavelength"]
    for name, values in expected["image"].items():
        known = np.where(np.isfinite(image[name]), image[name], -1)
        np.testing.assert_allclose(known, values, rtol=ROUNDING, err_msg=name)


@pytest.mark.parametrize("name", ["image.zarr", "image.nc"])
def test_image(name: str, expected: dict[str, Any], unpacked: Path) -> None:
    path = unpacked / name if name.endswith(".zarr") else FILES / name
    require_image(hf.read_image(path), expected)


def test_old_recording_and_calibration_still_give_the_image(
    expected: dict[str, Any], unpacked: Path, tmp_path: Path
) -> None:
    result = hf.reconstruct_file(
        FILES / "scene.mcap", tmp_path / "image.zarr", calibration=unpacked / "calibration.zarr"
    )
    depth = np.array(expected["image"]["depth"])
    assert (depth > 0).any()
    found, deviation = result.image["depth"].values, result.image["depth_std"].values
    np.testing.assert_array_equal(np.isfinite(found), depth > 0)
    # of some pixels 0.1.0 took the mean of the posterior, which is no longer taken for as many
    known = np.isfinite(found)
    assert (np.abs(found - depth)[known] < 0.1 * deviation[known]).all()
    np.testing.assert_array_equal(result.image["quality"], expected["image"]["quality"])


def test_configuration_of_the_daemon() -> None:
    config = pytest.importorskip("hueflight.daemon.config", reason="needs the extra daemon")
    read = config.DaemonConfig.load(FILES / "daemon.toml")
    assert (read.name, read.instrument, read.scene) == ("north bench", "tiny.toml", "plane")
    assert (read.simulate, read.camera, read.illuminator) == (True, "0123ABCD", "/dev/ttyUSB0")
    assert (read.method, read.pictures_hz, read.picture_frames) == ("joint", 12.5, 960)
    assert (read.change_sigma, read.threads, read.picture_threads) == (3.0, 2, 1)
    assert (read.server.port, read.server.token_file) == (8471, "token")
    assert read.server.allowed_hosts == ("bench.example",)
    assert (read.server.max_connections, read.server.max_viewers) == (32, 4)
    assert (read.server.requests_per_s, read.server.burst) == (25.0, 50)
    assert read.server.max_body_bytes == 32768
    assert (read.recording.queue_mb, read.recording.min_free_mb) == (64, 512)
