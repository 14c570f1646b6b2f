# SPDX-License-Identifier: Apache-2.0
"""The verdict on a long run of the daemon, which ``tools/bench/daemon.py --nightly`` gives."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from support.browser import require_chromium

FOLDER = Path(__file__).resolve().parents[3] / "tools/bench"


@pytest.fixture
def report(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    spec = importlib.util.spec_from_file_location("_daemon_report", FOLDER / "_daemon_report.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(**changes: Any) -> dict[str, Any]:
    """A run without fault: memory grows at first, and stays within one per cent later."""
    memory = [300.0, 400.0, 500.0, *(500.0 + 4 * (i % 2) for i in range(17))]
    return {
        "elapsed_s": 5400.0,
        "lost": {"sensor": 0, "fpga": 12, "usb": 0, "host": 3, "disk": 0},
        "recording": {"intact": 1000, "in_segments": 1000},
        "samples": [{"memory_mb": each} for each in memory],
    } | changes


def test_what_a_long_run_must_not_show(report: ModuleType) -> None:
    assert report.shortcomings(run()) == []  # frames that the camera's buffer had no room for
    lost = {"sensor": 0, "fpga": 0, "usb": 5, "host": 0, "disk": 7}
    assert report.shortcomings(run(lost=lost)) == [
        "5 frames were lost (place: usb)",
        "7 frames were lost (place: disk)",
    ]
    damaged = {"intact": 998, "in_segments": 1000}
    assert report.shortcomings(run(recording=damaged)) == ["2 recorded frames are damaged"]
    growing = [{"memory_mb": 500.0 + i} for i in range(20)]
    [found] = report.shortcomings(run(samples=growing))
    assert found == "memory went from 504 to 519 MB after the first fifth"
    assert report.shortcomings(run(samples=growing, elapsed_s=60.0)) == []  # it grows at first


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_short_run_as_by_night(tmp_path: Path) -> None:
    """The command of the long run, for some seconds at a low rate, with a browser."""
    require_chromium()
    options = ["--rate", "240", "--seconds", "15", "--folder", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, FOLDER / "daemon.py", "--nightly", *options],
        capture_output=True, text=True, timeout=360, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    lines = dict(re.findall(r"^\| ([^|]+) \| (.+) \|$", done.stdout, re.MULTILINE))
    ((recorded, of),) = re.findall(r"^([\d,]+) of ([\d,]+) frames", lines["recorded"])
    assert int(recorded.replace(",", "")) >= 15 * 200
    assert recorded == of
    # so short a run keeps all of its segments, whose frames are those recorded, each once
    assert f"read back: {recorded} of {recorded} frames intact" in lines["recorded"]
    assert float(lines["pictures made"].split()[0]) > 0
