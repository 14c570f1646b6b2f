# SPDX-License-Identifier: Apache-2.0
"""The way to a picture needs nothing that macOS or Windows lack.

Neither is at hand, so a process here does without the functions and modules that are missing there.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

#: missing in `os`, from Python's documentation of the availability of each function
MISSING = {
    "macOS": """posix_fadvise posix_fallocate sched_setscheduler sched_getaffinity
        sched_setaffinity sched_param memfd_create eventfd splice copy_file_range""",
    "Windows": """pread preadv pwrite pwritev posix_fadvise posix_fallocate sched_setscheduler
        sched_getaffinity sched_setaffinity sched_param setpriority getpriority PRIO_PROCESS nice
        statvfs fstatvfs sysconf fchown chown geteuid getuid getgid getegid fork register_at_fork
        O_DIRECTORY O_NOFOLLOW O_CLOEXEC O_NONBLOCK mkfifo uname killpg memfd_create eventfd
        splice copy_file_range sendfile""",
}
MODULES = {"macOS": "", "Windows": "resource fcntl termios pwd grp"}

WITHOUT = """
import os, sys
import numpy, scipy.special, scipy.ndimage, xarray, zarr, mcap, cyclopts, rich.console
import multiprocessing, subprocess, tempfile, asyncio, shutil, uuid  # what they do there is theirs
functions, modules, *steps = sys.argv[1:]
for name in functions.split():
    if hasattr(os, name):
        delattr(os, name)
for name in modules.split():
    sys.modules[name] = None
from hueflight.cli import main
for step in steps:
    try:
        main(step.split())
    except SystemExit as end:
        if end.code:
            raise
"""

STEPS = (
    "simulate --capture reference --distance 0.4 --frames 1000 -o reference.npz",
    "simulate fig1 --frames 100 -o scene.mcap",
    "info scene.mcap --check",
    "recover scene.mcap -o again.mcap",
    "calibrate reference.npz --distance 0.4 -o my.zarr",
    "reconstruct scene.mcap -c my.zarr -o scene.zarr",
    "reconstruct scene.mcap again.mcap -c my.zarr -o many",
    "export scene.zarr scene.csv",
    "view scene.zarr -o scene.html",
)


@pytest.mark.slow
@pytest.mark.parametrize("system", MISSING)
def test_a_picture_without_what_the_system_lacks(tmp_path: Path, system: str) -> None:
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONWARNINGS"}
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, MISSING[system], MODULES[system], *STEPS],
        cwd=tmp_path,
        env=settings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "scene.html").stat().st_size > 100_000
    assert (tmp_path / "many").is_dir()


def test_what_is_missing_there_is_here() -> None:
    """So that taking it away is a test; a name that was mistyped would take nothing away."""
    for names in MISSING.values():
        assert [name for name in names.split() if not hasattr(os, name)] == []
