# SPDX-License-Identifier: Apache-2.0
"""The daemon checks its calibration against the target or the scene, and corrects drift."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import hueflight as hf
from hueflight import simulator
from hueflight.acquisition.frame_accounting import RunTotals
from hueflight.acquisition.plan import CaptureError, RunPlan, RunResult
from hueflight.daemon.check_job import CheckJob
from support.slow_lock import SlowLock

DRIFT_PS = (-180.0, 160.0, 140.0, -120.0, 190.0, -120.0, 40.0, -180.0, 70.0)  # their mean is 0
QUIET = simulator.SimulationSettings.ideal(white_detections=0.05, ambient=0.01)
DRIFTED = QUIET.replace(effects=simulator.Effects(delay_drift_ps=DRIFT_PS))
FRAMES = 60_000
WAIT_S = 60.0


def capture(instrument: hf.Instrument, settings=QUIET, *, seed: int, **words) -> np.ndarray:
    words = {"distance": 1.0, "frames": FRAMES, **words}
    return simulator.simulate_capture(
        "reference", instrument, settings=settings, seed=seed, **words
    )


@pytest.fixture(scope="module")
def instrument() -> hf.Instrument:
    paper = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(paper.sensor, rows=16, cols=24)
    return paper.replace(sensor=sensor, lens=None)


@pytest.fixture(scope="module")
def calibration(instrument: hf.Instrument) -> hf.Calibration:
    bands = simulator.simulate_capture(
        "bands", instrument, frames=400_000, distance=1.0, settings=QUIET, seed=2
    )
    reference = capture(instrument, frames=400_000, seed=1)
    return hf.calibrate(reference, instrument, distance=1.0, bands=bands)


class Runs:
    """An acquisition that has the same counts for every run, and notes the plans."""

    def __init__(self, counts: np.ndarray, failure: str = "") -> None:
        self.counts, self.failure, self.plans = counts, failure, []
        self.held = threading.Event()
        self.held.set()

    def run(self, plan: RunPlan) -> Future[RunResult]:
        assert self.held.wait(WAIT_S)
        self.plans.append(plan)
        totals = RunTotals(exposed=plan.frames, delivered=plan.frames)
        future: Future[RunResult] = Future()
        future.set_result(RunResult(plan, totals, 0, {0: self.counts}, True, failure=self.failure))
        return future


@pytest.fixture
def job_with(calibration: hf.Calibration, tmp_path: Path) -> Callable[..., tuple[CheckJob, list]]:
    def made(runs: Any, known: hf.Calibration | None = calibration, **words):
        used: list[tuple[hf.Calibration, Path]] = []
        words = {"check_free": lambda: None, **words}
        job = CheckJob(
            runs, tmp_path, calibration=lambda: known, use=lambda *one: used.append(one), **words
        )
        return job, used

    return made


def finished(job: CheckJob, kind: Any, distance: float | None = None) -> CheckJob:
    job.begin(kind=kind, frames=FRAMES, distance=distance)
    deadline = time.monotonic() + WAIT_S
    while job.state.step not in ("done", "failed"):
        assert time.monotonic() < deadline, job.state
        time.sleep(0.01)
    deadline += 1
    while True:  # the thread lets go of the camera last
        try:
            job.check_idle()
        except CaptureError:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        else:
            return job


@pytest.mark.parametrize(("kind", "distance"), [("reference", 1.0), ("scene", 1.3)])
def test_a_calibration_that_holds(instrument, job_with, kind: str, distance: float) -> None:
    runs = Runs(capture(instrument, seed=3, distance=distance))
    job, _ = job_with(runs)
    state = finished(job, kind).state
    assert (state.step, state.findings) == ("done", ()), state
    assert "holds" in state.message
    assert runs.plans == [RunPlan(kind=kind, frames=FRAMES, keep=True)]
    with pytest.raises(CaptureError, match="no correction is offered"):
        job.correct()


def test_drift_in_a_capture_of_the_target_is_named(instrument, job_with) -> None:
    job, _ = job_with(Runs(capture(instrument, DRIFTED, seed=4)))
    state = finished(job, "reference").state
    assert any("arrives" in text for text in state.findings), state
    assert "no longer holds" in state.as_dict()["message"]
    assert state.correction is not None
    found = state.correction.provenance["drift"]["delay_ps"]
    assert np.corrcoef(found, DRIFT_PS)[0, 1] > 0.98


def test_drift_in_a_scene_is_offered_as_a_correction(instrument, job_with, calibration) -> None:
    job, used = job_with(Runs(capture(instrument, DRIFTED, seed=5, distance=1.3)))
    state = finished(job, "scene").state
    assert [text.split(":")[0] for text in state.findings] == ["delay"]
    assert state.as_dict()["correction"] is True
    path = job.correct()
    ((corrected, kept),) = used
    assert kept == path
    found = corrected.provenance["drift"]["delay_ps"]
    assert np.corrcoef(found, DRIFT_PS)[0, 1] > 0.98
    assert hf.Calibration.load(path).provenance["drift"]["delay_ps"] == found
    assert job.state.step == "corrected"
    assert not job.state.as_dict()["correction"]
    with pytest.raises(CaptureError, match="no correction"):
        job.correct()


def test_what_can_not_be_checked_says_why(instrument, job_with) -> None:
    runs = Runs(capture(instrument, seed=3), failure="the camera was unplugged")
    job, _ = job_with(runs)
    state = finished(job, "scene").state
    assert state.step == "failed"
    assert "unplugged" in state.message
    with pytest.raises(CaptureError, match="calibrate first"):
        job_with(runs, None)[0].begin(kind="scene", frames=1, distance=None)

    def taken() -> None:
        raise CaptureError("recording 'a' is in progress")

    busy, _ = job_with(runs, check_free=taken)
    for _ in range(2):  # the refusal leaves the job free
        with pytest.raises(CaptureError, match="recording 'a'"):
            busy.begin(kind="scene", frames=1, distance=None)
        busy.check_idle()


def test_only_one_check_at_a_time(instrument, job_with) -> None:
    runs = Runs(capture(instrument, seed=3))
    runs.held.clear()
    job, _ = job_with(runs)
    job.begin(kind="reference", frames=1, distance=None)
    for refused in (job.check_idle, job.correct):
        with pytest.raises(CaptureError, match="in progress"):
            refused()
    with pytest.raises(CaptureError, match="in progress"):
        job.begin(kind="reference", frames=1, distance=None)
    runs.held.set()


def test_whoever_sees_the_end_may_begin_again(job_with) -> None:
    job, _ = job_with(Runs(np.zeros(0), failure="unplugged"))
    job._busy = SlowLock()
    for _ in range(2):
        job.begin(kind="scene", frames=FRAMES, distance=None)
        deadline = time.monotonic() + WAIT_S
        while job.state.step != "failed":
            assert time.monotonic() < deadline
            time.sleep(0.001)
