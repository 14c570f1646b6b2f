# SPDX-License-Identifier: Apache-2.0
"""A sample of the runs with faults at random; ``tools/dev.py faults`` makes more of them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from support.emulation import require_packages
from support.fault_runs import machine
from support.fault_runs.faults import FAULTS
from support.fault_runs.plan import DISK, GROUPS, make_plan
from support.fault_runs.run import fault_run
from support.mounts import require_mounts

SEEDS = (4, 6, 15, 21, 34, 38)  #: of short runs with faults of many kinds


def test_every_fault_happens_and_is_replayed() -> None:
    """A seed is a run; a thousand seeds have all faults."""
    assert make_plan(17) == make_plan(17)
    named = {name for group in GROUPS for name in group if name != "disk"}
    named |= {name for names in DISK.values() for name in names}
    assert named == set(FAULTS)
    assert {step.fault for seed in range(1000) for step in make_plan(seed).steps} == named


def test_a_run_that_fails_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its disk is unmounted, also if the daemon did not even start."""
    require_packages()
    require_mounts()

    def no_daemon(*_: object, **__: object) -> None:
        raise AssertionError("it did not start")

    monkeypatch.setattr(machine, "Daemon", no_daemon)
    seed = next(seed for seed in range(100) if make_plan(seed).disk == "small")
    result = fault_run(seed, tmp_path / "shims")
    assert "it did not start" in result.failure
    folder = Path(result.failure.partition("(see ")[2].removesuffix(")"))
    assert (folder / "failure.txt").exists()
    assert not (folder / "run" / "data").is_mount()
    shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_books_are_right_in_the_end(seed: int, tmp_path: Path) -> None:
    require_packages()
    require_mounts()
    result = fault_run(seed, tmp_path / "shims")
    assert result.failure == "", result
    assert result.frames_recorded > 0
