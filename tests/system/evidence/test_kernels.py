# SPDX-License-Identifier: Apache-2.0
"""Failing allocations and threads of the kernels, under the sanitizers of GCC."""

import shutil
from collections.abc import Callable
from types import ModuleType

import pytest

from hueflight.backend import KERNELS, available

Evidence = Callable[[str], ModuleType]

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not here")


@pytest.mark.slow
@needs_gcc
def test_every_allocation_may_fail(evidence: Evidence) -> None:
    report = evidence("allocations").report(quick=True)
    assert report.findings == []
    assert "| allocations of the kernels | 0 |" not in report.text


@pytest.mark.slow
@needs_gcc
def test_no_race_but_that_of_the_control(evidence: Evidence) -> None:
    report = evidence("threads").report(quick=True)
    assert report.findings == []
    assert "| races found in the control | yes |" in report.text


@pytest.mark.skipif(not all(map(available, KERNELS)), reason="no compiled kernels here")
def test_the_work_calls_every_function(evidence: Evidence) -> None:
    workload = evidence("workload")
    with workload.recorded_calls() as calls:
        workload.work(threads=1)
    called = {(call.module.rpartition("_v")[0] or call.module, call.function) for call in calls}
    declared = {
        (kernel.builds[-1], function.name)
        for kernel in KERNELS.values()
        for function in kernel.interface.functions
    }
    assert declared <= called
