# SPDX-License-Identifier: Apache-2.0
"""The released kernels on 64-bit ARM, in an emulator, against their NumPy definitions."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hueflight.backend import KERNELS
from support import aarch64

ROOT = Path(__file__).resolve().parents[3]
#: tests that compare the compiled kernels with their definitions, and with the reference parser
KERNEL_TESTS = (
    "tests/host/ingest/test_kernels.py::test_compiled_and_numpy_say_the_same",
    "tests/host/fit/test_correlation.py",
    "tests/host/fit/test_solver.py::test_same_results",
    "tests/host/reconstruction/test_paper_kernel.py",
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(2400),  # an emulated processor is twenty times slower
    pytest.mark.skipif(bool(aarch64.missing()), reason=f"needs {', '.join(aarch64.missing())}"),
]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> aarch64.Aarch64:
    """Python for that processor, with the wheel installed."""
    folder = tmp_path_factory.mktemp("aarch64")
    build = [sys.executable, ROOT / "tools" / "packages.py", "--architecture", "aarch64"]
    subprocess.run([*build, "--out", folder], check=True)
    (wheel,) = folder.glob("*aarch64.whl")
    machine = aarch64.Aarch64(folder / "machine")
    machine.install(
        *(str(wheel), "pytest", "pytest-timeout", "hypothesis"),
        constraints=ROOT / "constraints.txt",
    )
    return machine


def test_the_wheel_brings_every_kernel(machine: aarch64.Aarch64, tmp_path: Path) -> None:
    program = (
        "import platform; from hueflight.backend import describe; "
        "print(platform.machine(), *describe().values(), sep='\\n')"
    )
    done = machine.python("-c", program, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    processor, *kernels = done.stdout.splitlines()
    assert processor == "aarch64"
    assert [text.partition(" ")[0] for text in kernels] == ["compiled"] * len(KERNELS)


def test_the_kernels_are_their_definitions(machine: aarch64.Aarch64) -> None:
    done = machine.python("-m", "pytest", "-q", "-p", "no:cacheprovider", *KERNEL_TESTS, cwd=ROOT)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-1000:]
    assert " passed" in done.stdout
    skips = [line for line in done.stdout.splitlines() if line.startswith("SKIPPED")]
    assert [line for line in skips if "this processor can't run" not in line] == []
