# SPDX-License-Identifier: Apache-2.0
"""A gate on the instructions of the joint fit, which no other work on the machine changes."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[3] / "tools" / "bench" / "reconstruction.py"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not here")
@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not here")
def test_instructions_per_pixel() -> None:
    command = [sys.executable, str(BENCH), "instructions", "--gate", "14500"]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert finished.returncode == 0, finished.stdout[-3000:] + finished.stderr[-3000:]
