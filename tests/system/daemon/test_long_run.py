# SPDX-License-Identifier: Apache-2.0
"""The verdict on a long run of the daemon, which ``tools/bench/daemon.py --nightly`` gives."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

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
