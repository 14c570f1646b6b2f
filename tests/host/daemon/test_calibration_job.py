# SPDX-License-Identifier: Apache-2.0
"""A calibration is never made of part of its frames in silence."""

from __future__ import annotations

import time
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import hueflight as hf
from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.plan import RunPlan, RunResult
from hueflight.acquisition.snapshot import Snapshot
from hueflight.daemon.calibration_job import CalibrationJob
from support.slow_lock import SlowLock

WAIT_S = 60.0


class ShortRuns:
    """An acquisition whose runs record fewer frames than they should."""

    def __init__(self, instrument: hf.Instrument, missing: int) -> None:
        self.instrument, self._missing = instrument, missing
        self.snapshot = Snapshot()
        self.settings = SimpleNamespace(rate_hz=1000.0)
        self.controls = SimpleNamespace(leaves_out=False)
        self.runs = 0

    def run(self, plan: RunPlan) -> Future[RunResult]:
        self.runs += 1
        taken = plan.frames - self._missing
        future: Future[RunResult] = Future()
        totals = RunTotals(exposed=plan.frames, delivered=taken)
        future.set_result(RunResult(plan, totals, 0, {}, False, recorded_frames=taken))
        return future


@pytest.mark.parametrize(("missing", "refused"), [(11, True), (10, False)])
def test_a_capture_may_lack_few_frames(
    instrument: hf.Instrument, tmp_path: Path, missing: int, refused: bool
) -> None:
    acquisition: Any = ShortRuns(instrument, missing)
    job = CalibrationJob(acquisition, tmp_path, use=lambda _: None)
    job.begin(distance=0.4, frames=1000, bands=False, dark=False)
    deadline = time.monotonic() + WAIT_S
    while job.state.step != "failed":  # there is no recording to compute the other one of
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert (f"has {1000 - missing} of 1000 frames" in job.state.message) == refused


def test_whoever_sees_the_end_may_begin_again(instrument: hf.Instrument, tmp_path: Path) -> None:
    acquisition: Any = ShortRuns(instrument, 11)
    job = CalibrationJob(acquisition, tmp_path, use=lambda _: None)
    job._busy = cast(Any, SlowLock())
    for _ in range(2):
        job.begin(distance=0.4, frames=1000, bands=False, dark=False)
        deadline = time.monotonic() + WAIT_S
        while job.state.step != "failed":
            assert time.monotonic() < deadline
            time.sleep(0.001)
