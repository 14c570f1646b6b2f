# SPDX-License-Identifier: Apache-2.0
"""Every allocation of the kernels fails once: no crash, no leak, and the next call is right.

The kernels are compiled with AddressSanitizer and with allocations that fail on demand
(`failing_allocations.h`). Calls that a reconstruction makes are repeated: in the first try the
first allocation fails, then the second one, until a call succeeds. The same is done to the
allocations of the interpreter during a call. A failed call must raise `MemoryError`, free what it
has allocated and release the arrays; the one that succeeds must give the same numbers as an
ordinary one.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from ctypes import CDLL
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from builds import PORTABLE, build, runtime
from report import ROOT, Report, table
from workload import Call, recorded_calls, work

SHOWN = ("calls", "allocations of the kernels", "allocations of the interpreter")
PASSES = 12
"""Calls in a row that succeed, after which the interpreter is taken to make no more allocations."""
HEADER = ROOT / "tools" / "evidence" / "failing_allocations.h"


def report(quick: bool) -> Report:
    """Return the figures of the page; the kernels are always tried completely."""
    del quick
    with tempfile.TemporaryDirectory() as name:
        flags = ("-O1", "-g", "-fsanitize=address", "-include", str(HEADER))
        made = build(Path(name) / "tree", "gcc", *flags, only=PORTABLE)
        environment = made.environment(
            LD_PRELOAD=runtime("gcc", "libasan.so"), ASAN_OPTIONS="detect_leaks=0"
        )
        command = [sys.executable, str(Path(__file__))]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        return Report("", [f"exit code {done.returncode}: {done.stderr[-3000:]}"])
    found = json.loads(done.stdout)
    rows = [[name, str(found["counts"][name])] for name in SHOWN]
    rows.append(["crashes, leaks, wrong results", str(len(found["findings"]))])
    return Report(table(["allocation failures in the kernels", "number"], rows), found["findings"])


def try_all() -> dict[str, Any]:
    """Try all calls in this process, whose kernels are those of `report`."""
    with recorded_calls() as calls:
        work(threads=1)
    counts: Counter[str] = Counter()
    findings: list[str] = []
    for call in calls:
        counts["calls"] += 1
        _try_call(call, counts, findings)
    return {"counts": counts, "findings": findings}


def _try_call(call: Call, counts: Counter[str], findings: list[str]) -> None:
    module = import_module(call.module)
    function = getattr(module, call.function)
    library = CDLL(str(module.__file__))
    expected = Attempt(call)
    expected.make(function)
    where = f"{call.module}.{call.function}"
    for number in range(1000):
        attempt = Attempt(call)
        library.allocations_fail(number)
        failed = attempt.make(function)
        if library.allocations_held():
            findings.append(f"{where}: allocation {number} fails, and others are not freed")
        happened = library.allocations_left() < 0
        library.allocations_fail(-1)
        findings += attempt.wrong(where, number, expected, failed=failed, should_fail=happened)
        if not happened:
            break
        counts["allocations of the kernels"] += 1
    _try_interpreter(function, call, where, counts, findings)


def _try_interpreter(
    function: Any, call: Call, where: str, counts: Counter[str], findings: list[str]
) -> None:
    hooks = import_module("_testcapi")  # the interpreter's own tests use it for this
    passes, number = 0, 0
    while passes < PASSES:
        attempt = Attempt(call)
        hooks.set_nomemory(number, number + 1)
        try:
            failed = attempt.make(function)
        finally:
            hooks.remove_mem_hooks()
        passes = 0 if failed else passes + 1
        counts["allocations of the interpreter"] += failed
        findings += attempt.wrong(where, number, expected=None, failed=failed, should_fail=failed)
        number += 1


class Attempt:
    """One call, with arguments of its own."""

    def __init__(self, call: Call) -> None:
        self._arrays = [np.array(a) for a in call.arguments if isinstance(a, np.ndarray)]
        self._views = [array.data for array in self._arrays]
        views = iter(self._views)
        self._arguments = tuple(
            next(views) if isinstance(a, np.ndarray) else a for a in call.arguments
        )

    def make(self, function: Any) -> bool:
        """Call a function; return whether memory was lacking."""
        try:
            function(*self._arguments)
        except MemoryError:
            return True
        return False

    def wrong(
        self, where: str, number: int, expected: Attempt | None, *, failed: bool, should_fail: bool
    ) -> list[str]:
        """Return what is wrong after the call."""
        found = []
        try:
            for view in self._views:
                view.release()
        except BufferError:
            found.append(f"{where}: after allocation {number} an array is not released")
        if failed != should_fail:
            found.append(f"{where}: allocation {number} failed, and the call did not say so")
        if expected is not None and not failed:
            same = zip(self._arrays, expected._arrays, strict=True)
            if not all(a.tobytes() == b.tobytes() for a, b in same):
                found.append(f"{where}: the call after the failures gives other numbers")
        return found


if __name__ == "__main__":
    print(json.dumps(try_all()))
