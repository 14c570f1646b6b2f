# SPDX-License-Identifier: Apache-2.0
"""`hueflight capture` as people call it, on the simulated instrument."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight import simulator
from hueflight.batch import reconstruct_file
from hueflight.errors import HueflightError
from hueflight.recording import open_recording, read_sums
from hueflight.recording.recorded_sums import describe_recorded_sums

COMMAND = [sys.executable, "-c", "from hueflight.cli import main; main()", "capture"]
PATIENCE_S = 60


@pytest.fixture(scope="module")
def instrument(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = (resources.files("hueflight.model") / "presets" / "paper.toml").read_text("utf-8")
    text = re.sub(r"(?m)^rows = 192$", "rows = 12", text)
    path = tmp_path_factory.mktemp("instrument") / "small.toml"
    path.write_text(re.sub(r"(?m)^cols = 128$", "cols = 8", text))
    return path


def test_one_led_at_a_time(instrument: Path, tmp_path: Path) -> None:
    out = tmp_path / "bands.mcap"
    options = ["--simulate", "--frames", "40", "--instrument", str(instrument), "--json"]
    finished = subprocess.run(
        [*COMMAND, "bands", *options, "-o", str(out)],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    summary = json.loads(finished.stdout)
    assert (summary["exposed"], summary["recorded_frames"]) == (9 * 40, 9 * 40)
    assert summary["simulated"]
    with open_recording(out) as recording:
        counts = recording.histograms_by_step()
        assert recording.info().as_dict()["metadata"]["simulated"] == "true"
    assert counts.shape == (9, 12, 8, 512)
    assert (counts.sum(axis=-1) == 40).all()


def test_ctrl_c_finishes_the_recording(instrument: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene.mcap"
    part = tmp_path / "scene.mcap.part"
    options = ["--simulate", "--instrument", str(instrument), "--json"]
    process = subprocess.Popen(
        [*COMMAND, "scene", *options, "-o", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + PATIENCE_S
    while not (part.exists() and part.stat().st_size > 10_000):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    summary = json.loads(output)
    assert summary["recorded_frames"] == summary["delivered"] == summary["exposed"] > 0
    assert not part.exists()
    with open_recording(out) as recording:
        assert recording.info().as_dict()["complete"]


def test_no_camera_is_said_with_a_way_out(instrument: Path, tmp_path: Path) -> None:
    pytest.importorskip("usb", reason="pyusb is not installed (extra devices)")
    options = ["--no-simulate", "--camera", "NONE", "--instrument", str(instrument)]
    finished = subprocess.run(
        [*COMMAND, "scene", *options, "-o", str(tmp_path / "x.mcap")],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert finished.returncode == 1
    assert "Traceback" not in finished.stderr
    assert "--simulate" in finished.stderr or "libusb" in finished.stderr


def test_sums_fit_what_the_camera_has_room_for(instrument: Path, tmp_path: Path) -> None:
    described = hf.Instrument.load(instrument)
    reference = simulator.simulate_capture("reference", described, frames=4000, distance=0.4)
    hf.calibrate(reference, described, distance=0.4).save(tmp_path / "cal.zarr")
    out = tmp_path / "sums.mcap"
    program = (
        "from hueflight.emulation import camera_model; from hueflight_protocol import "
        "ReductionRoom; camera_model.ReductionRoom = lambda: ReductionRoom(12, 3, 10, 64, 8); "
        "from hueflight.cli import main; main()"
    )
    options = [
        "capture", "scene", "--simulate", "--frames", "300", "--instrument", str(instrument),
        "--reduce", "--calibration", str(tmp_path / "cal.zarr"), "--picture-frames", "60",
        "-o", str(out),
    ]  # fmt: skip
    finished = subprocess.run(
        [sys.executable, "-c", program, *options],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    with open_recording(out) as recording:
        sums = read_sums(recording)
        tables = describe_recorded_sums(recording).tables
    assert (sums.frames == 300).all()
    assert (tables.sums, tables.entry_bits) == (12, 3)
    assert max(tables.widths[:4]) <= 10
    assert max(tables.widths[4:]) <= 9


def test_sums_instead_of_codes(instrument: Path, tmp_path: Path) -> None:
    described = hf.Instrument.load(instrument)
    reference = simulator.simulate_capture("reference", described, frames=4000, distance=0.4)
    calibration = hf.calibrate(reference, described, distance=0.4)
    calibration.save(tmp_path / "cal.zarr")
    out = tmp_path / "sums.mcap"
    options = [
        "--simulate", "--frames", "500", "--instrument", str(instrument), "--json", "--reduce",
        "--calibration", str(tmp_path / "cal.zarr"), "--picture-frames", "120",
    ]  # fmt: skip
    finished = subprocess.run(
        [*COMMAND, "scene", *options, "-o", str(out)],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    summary = json.loads(finished.stdout)
    counted = [summary[name] for name in ("exposed", "delivered", "recorded_frames")]
    assert counted == [500, 500, 500]
    with open_recording(out) as recording:
        assert recording.frames == 0
        sums = read_sums(recording)
    assert (sums.frames == 500).all()
    assert (sums.pictures, sums.losses) == (5, {})
    assert summary["photons"] == int(sums.values[..., 0].sum())
    result = reconstruct_file(out, tmp_path / "image.zarr", calibration=calibration)
    truth = simulator.scene("fig1", described).depth
    error = result.image["depth"].values - truth
    known = np.isfinite(error)
    near = np.abs(error) < 4 * result.image["depth_std"].values
    assert known.sum() > 20  # 47 photons a pixel are few
    assert near[known].mean() > 0.9
    with pytest.raises(HueflightError, match="method 'joint' needs histograms"):
        reconstruct_file(
            out, tmp_path / "other.zarr", calibration=calibration, options={"method": "joint"}
        )
