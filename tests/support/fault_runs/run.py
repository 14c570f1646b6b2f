# SPDX-License-Identifier: Apache-2.0
"""One run from its seed to its result."""

from __future__ import annotations

import json
import shutil
import signal
import tempfile
import time
import traceback
from dataclasses import asdict, dataclass
from pathlib import Path

from support.fault_runs.books import check_recordings, check_totals
from support.fault_runs.faults import FAULTS
from support.fault_runs.machine import Machine
from support.fault_runs.plan import FaultPlan, make_plan


@dataclass(frozen=True)
class FaultResult:
    """What came of a run.

    Attributes
    ----------
    seed : seed of the run.
    faults : names of its faults.
    told_s : fault and time until `/health` told of it, for those that it must tell of.
    frames_exposed, frames_recorded : frames of the camera, and frames in files that were checked.
    failure : what was wrong; empty if nothing was.
    seconds : duration of the run.
    """

    seed: int
    faults: list[str]
    told_s: list[tuple[str, float]]
    frames_exposed: int
    frames_recorded: int
    failure: str
    seconds: float

    def as_json(self) -> str:
        return json.dumps(asdict(self))


def fault_run(seed: int, build: Path, *, keep: bool = False) -> FaultResult:
    """Run the faults of a seed, and check the books.

    The folder of a run that fails is kept; so are others with `keep`.
    """
    plan, began_s = make_plan(seed), time.monotonic()
    folder = Path(tempfile.mkdtemp(prefix=f"fault-run-{seed}-"))
    machine, failure, recorded = None, "", 0
    try:
        machine = Machine(plan, folder / "run", build)
        recorded = _run(plan, machine)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        words = "".join(traceback.format_exception(error))
        failure = f"{type(error).__name__}: {error}"
        (folder / "failure.txt").write_text(f"{plan}\n{words}")
    finally:
        if machine is not None:
            closing = _closed(machine)  # in any case
            failure = failure or closing
            (folder / "log.jsonl").write_text("".join(machine.logs))
    if failure:
        failure += f" (see {folder})"
    elif not keep:
        shutil.rmtree(folder)
    return FaultResult(
        seed=seed,
        faults=[step.fault for step in plan.steps],
        told_s=machine.told_s if machine else [],
        frames_exposed=machine.model.sent.frames if machine else 0,
        frames_recorded=recorded,
        failure=failure,
        seconds=round(time.monotonic() - began_s, 1),
    )


def _closed(machine: Machine) -> str:
    """Close everything; what is wrong with it, if anything is."""
    try:
        machine.close()
    except (AssertionError, OSError) as error:
        return f"closing: {error}"
    return ""


def _run(plan: FaultPlan, machine: Machine) -> int:
    machine.begin()
    for step in plan.steps:
        machine.record()
        machine.note_told()
        FAULTS[step.fault](machine, step)
        machine.frames_come()
        time.sleep(step.pause_s)
    machine.end_recording()
    check_totals(machine)
    recorded = check_recordings(machine)
    machine.end(signal.SIGTERM)
    _check_logs(machine)
    return recorded


def _check_logs(machine: Machine) -> None:
    """No request failed, and no part of the program but those that were told to."""
    for line in "".join(machine.logs).splitlines():
        if line.startswith("{"):
            entry = json.loads(line)
            assert entry["event"] != "a request failed", line[:2000]
            trace = str(entry.get("traceback", "")) + str(entry.get("exception", ""))
            assert not trace or "asked for" in trace, line[:3000]
        else:
            assert not line.startswith("Traceback"), line
