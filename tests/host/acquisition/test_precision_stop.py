# SPDX-License-Identifier: Apache-2.0
"""Captures that end when a share of the pixels is known well enough, on simulated instruments."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import hueflight as hf
from hueflight.acquisition.plan import CaptureError, RunPlan
from hueflight.acquisition.precision_stop import PrecisionMonitor, PrecisionStop
from hueflight.acquisition.thread_priority import ThreadPriority
from hueflight.cli.capture import until_of
from hueflight.reconstruction.stopping import StopRule, seen_enough, share_known
from hueflight.recording import open_recording

COMMAND = [sys.executable, "-c", "from hueflight.cli import main; main()", "capture", "scene"]
PATIENCE_S = 60


@pytest.fixture(scope="module")
def instrument(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = (resources.files("hueflight.model") / "presets" / "paper.toml").read_text("utf-8")
    text = re.sub(r"(?m)^rows = 192$", "rows = 12", text)
    path = tmp_path_factory.mktemp("instrument") / "small.toml"
    path.write_text(re.sub(r"(?m)^cols = 128$", "cols = 8", text))
    return path


@pytest.fixture(scope="module")
def calibration(instrument: Path, draw) -> hf.Calibration:
    known = hf.Instrument.load(instrument)
    return hf.calibrate(draw(known, depth=0.4, photons=5000, frames=10**6), known, distance=0.4)


def test_the_command_stops_when_depth_is_known(
    instrument: Path, calibration: hf.Calibration, tmp_path: Path
) -> None:
    calibration.save(tmp_path / "known.zarr")
    out = tmp_path / "scene.mcap"
    finished = subprocess.run(
        [*COMMAND, "--simulate", "--instrument", str(instrument), "--json", "--yes",
         "--calibration", str(tmp_path / "known.zarr"), "--until-depth-std", "0.3",
         "--share", "0.3", "--frames", "1000000", "-o", str(out)],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    summary = json.loads(finished.stdout)
    assert 0 < summary["recorded_frames"] < 1_000_000
    assert summary["share_known"] >= 0.3
    assert not summary["failure"]
    with open_recording(out) as recording:
        image = hf.reconstruct(recording.histogram(), calibration)
    assert seen_enough(image, StopRule(depth_std=0.3, share=0.3))


@pytest.mark.parametrize(
    ("calibration", "depth_std", "share", "message"),
    [
        (None, 0.01, 0.9, "--calibration"),
        (None, -1.0, 0.9, "depth_std = -1"),
        (None, 0.01, 2.0, "share = 2"),
        (Path("none.zarr"), None, 0.9, "--until-depth-std"),
        (Path("none.zarr"), 0.01, 0.9, "none.zarr"),
    ],
)
def test_wishes_that_cannot_be_met_are_said(
    instrument: Path, calibration: Path | None, depth_std: float, share: float, message: str
) -> None:
    with pytest.raises(hf.HueflightError, match=message):
        until_of(hf.Instrument.load(instrument), calibration, depth_std, None, share)


def test_only_a_scene_has_depth_to_be_known(calibration: hf.Calibration) -> None:
    wanted = PrecisionStop(StopRule(depth_std=0.01), calibration)
    RunPlan(precision_stop=wanted).check()
    with pytest.raises(CaptureError, match="'dark' can't end by what is known"):
        RunPlan(kind="dark", precision_stop=wanted).check()


def settle(watch: PrecisionMonitor) -> bool:
    """Poll until the look that is on has ended."""
    deadline = time.monotonic() + PATIENCE_S
    met = watch.poll()
    while watch.looking:
        assert time.monotonic() < deadline
        time.sleep(0.005)
        met = watch.poll()
    return met


def test_blocks_add_up_until_enough_is_known(calibration: hf.Calibration, draw) -> None:
    rule = StopRule(depth_std=0.02, share=0.9)
    watch = PrecisionMonitor(PrecisionStop(rule, calibration))
    assert not watch.poll()
    assert watch.share is None
    shape = calibration.instrument.histogram_shape
    total = np.zeros(shape, np.uint32)
    shares = []
    for seed in range(40):
        block = draw(calibration.instrument, depth=0.6, photons=100, frames=1000, seed=seed)
        total += block
        watch.add(block, 1000)
        met = settle(watch)
        shares.append(watch.share)
        if met:
            break
    image = hf.reconstruct(total, calibration)
    assert met == seen_enough(image, rule)
    assert watch.share == share_known(image, rule)
    assert shares[0] is not None
    assert shares[0] < 0.9
    assert len(shares) > 2
    watch.close()


def test_looks_step_back_from_what_begins_them(
    calibration: hf.Calibration, draw, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr("hueflight.acquisition.precision_stop.set_thread_priority", asked.append)
    watch = PrecisionMonitor(PrecisionStop(StopRule(depth_std=0.02), calibration))
    watch.add(draw(calibration.instrument, depth=0.6, photons=100, frames=1000, seed=1), 1000)
    settle(watch)
    watch.close()
    assert asked == [ThreadPriority.RECONSTRUCTION]


def test_a_histogram_of_another_instrument_ends_the_run_with_its_reason(
    calibration: hf.Calibration,
) -> None:
    watch = PrecisionMonitor(PrecisionStop(StopRule(depth_std=0.02), calibration))
    watch.add(np.ones((3, 3, 512), np.uint16), 1000)
    with pytest.raises(hf.HueflightError, match=r"\(3, 3, 512\)"):
        settle(watch)
    watch.close()
