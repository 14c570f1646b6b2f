# SPDX-License-Identifier: Apache-2.0
"""Failing allocations and threads of the kernels, under the sanitizers of GCC."""

import shutil
from collections.abc import Callable
from types import ModuleType

import pytest

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
