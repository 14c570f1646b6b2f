# SPDX-License-Identifier: Apache-2.0
"""Short runs of the fuzzers in tools/fuzz, and the gate on instructions."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hueflight.ingest.kernels import available

TOOLS = Path(__file__).resolve().parents[3] / "tools"


def run(tool: str, *arguments: str) -> str:
    """Output of a tool, which must end well."""
    command = [sys.executable, str(TOOLS / tool), *arguments]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr[-3000:]
    return finished.stdout


@pytest.mark.skipif("c" not in available(), reason="no compiled kernels here")
def test_c_and_numpy_agree_on_the_corpus() -> None:
    assert "no difference" in run("fuzz/differential.py", "--corpus", "--seconds", "1")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not here")
def test_no_finding_of_the_sanitizers() -> None:
    run("fuzz/differential.py", "--corpus", "--seconds", "5", "--sanitize")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("clang") is None, reason="clang is not here")
def test_no_finding_of_libfuzzer() -> None:
    run("fuzz/kernels.py", "--seconds", "10")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not here")
def test_instructions_per_pixel() -> None:
    assert "count" in run("bench/ingest.py", "instructions", "--gate", "6")
