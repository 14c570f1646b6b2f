# SPDX-License-Identifier: Apache-2.0
"""The kernels with several threads under ThreadSanitizer, which finds unordered accesses.

The kernels are compiled with it; the interpreter and its libraries are not, so that only accesses
of the kernels are judged, and those of functions of the C library that it replaces. As a control,
two threads count into the same histogram, which it must find.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
from builds import PORTABLE, Build, build, runtime
from report import Report, table
from workload import recorded_calls, work

from hueflight.backend import compiled

THREADS = 4
CONTROL_CALLS = 10_000  # so many that two overlap also on one free core


def report(quick: bool) -> Report:
    """Return the figures of the page."""
    rounds = 1 if quick else 3
    with tempfile.TemporaryDirectory() as name:
        made = build(Path(name) / "tree", "gcc", "-O1", "-g", "-fsanitize=thread", only=PORTABLE)
        races = _races(made, "--inside", str(rounds))
        control = _races(made, "--control", "0")
    findings = [] if control else ["the control's race was not found"]
    findings += races
    rows = [
        ["threads of each call", str(THREADS)],
        ["rounds of work", str(rounds)],
        ["races found", str(len(races))],
        ["races found in the control", "yes" if control else "none"],
    ]
    return Report(table(["ThreadSanitizer", "result"], rows), findings)


def _races(made: Build, *words: str) -> list[str]:
    """Run this file in another process; return what ThreadSanitizer says."""
    environment = made.environment(
        LD_PRELOAD=runtime("gcc", "libtsan.so"),
        TSAN_OPTIONS="exitcode=0",
        OPENBLAS_NUM_THREADS="1",  # it waits in ways that are not seen without its sources
    )
    # without randomization of addresses, for which the library has no room on new systems
    command = ["setarch", "-R", sys.executable, str(Path(__file__)), *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if "did the work" not in done.stdout:
        raise SystemExit(f"exit code {done.returncode}: {done.stderr[-3000:]}")
    return re.findall(r"SUMMARY: ThreadSanitizer: (.*)", done.stderr)


def control() -> None:
    """Count into the same histogram from two threads, which is an error."""
    ingest = compiled("ingest", "c")
    assert ingest is not None
    with recorded_calls() as calls:
        work(threads=1)
    call = next(call for call in calls if call.function == "count")
    arguments = [np.array(a) if isinstance(a, np.ndarray) else a for a in call.arguments]
    together = Barrier(2)

    def some() -> None:
        together.wait()
        for _ in range(CONTROL_CALLS):
            ingest.count(*arguments)

    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(some) for _ in range(2)]:
            done.result()


if __name__ == "__main__":
    if sys.argv[1] == "--control":
        control()
    for _ in range(int(sys.argv[2])):
        work(threads=THREADS)
    print("did the work")
