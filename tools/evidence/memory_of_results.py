# SPDX-License-Identifier: Apache-2.0
"""Memory runs out once while an image is made or written: the error says so, and nothing is left.

A reconstruction and the writing of an image in each format are done again and again, each time in a
process of its own. Memory fails in two ways: one allocation of the interpreter
fails, the first one, a later one, and so on; or the process may take only a little more memory than
it has, then more, until it suffices. A run that fails must end with an error of Hueflight. Files
under the final name must be complete, nothing else may be left beside them, and the same work must
give the same result when there is memory again.
"""

from __future__ import annotations

import ctypes
import resource
import shutil
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import xarray as xr
from child_process import in_child
from power_cuts import MEMORY
from report import Report, table
from workload import draw

import hueflight as hf
from hueflight.errors import HueflightError, MissingPackageError
from hueflight.export import FORMATS, describe, formats, write
from hueflight.reconstruction import entry_point

ROWS, COLS = 48, 64
FINENESS, QUICK_FINENESS = 2, 1
"""Allocations that are tried one by one; later ones are tried at growing distances."""
QUICK = ("reconstruct", "write csv")
PASSES = 8
"""Runs in a row without a failure, after which memory is taken to suffice."""
MAPPED = (-3, 64 << 10)
"""M_MMAP_THRESHOLD of mallopt(3): larger arrays are given back to the system when freed."""
STEP_BYTES = 64 << 10  #: between limits of memory
LONGEST_S = 20
MOST_FINDINGS = 10
OUTCOMES = {
    "refused": "the work ended with an error of Hueflight that says so",
    "uncalled": "the function could not even be called: MemoryError",
    "complete": "the error came when the result was complete",
    "other": "a library or the interpreter raised another error",
    "ended": "a library or the interpreter crashed or hung",
}


@dataclass(frozen=True)
class Work:
    """Something that needs memory.

    Attributes
    ----------
    name : str
        For findings.
    do : callable
        Does it, with files in a folder, and returns its result.
    """

    name: str
    do: Callable[[Path], Any]

    def result(self, folder: Path) -> list[Any]:
        """Do it; return its result as plain values, and the sizes of its files."""
        return [_plain(self.do(folder)), files_in(folder)]


def _plain(result: Any) -> Any:
    """Return the values of an image, in a form that can be compared."""
    if isinstance(result, xr.Dataset):
        return {str(name): _plain(values.values) for name, values in result.variables.items()}
    if isinstance(result, np.ndarray):
        return np.asarray(result).tobytes()
    return None


def files_in(folder: Path) -> dict[str, int]:
    """Return the sizes of all files below a folder by name."""
    return {
        str(path.relative_to(folder)): path.stat().st_size
        for path in sorted(folder.rglob("*"))
        if path.is_file() or not any(path.iterdir())
    }


def works() -> Iterator[Work]:
    """Return what is tried."""
    instrument = hf.Instrument.load("paper")
    sensor = msgspec.structs.replace(instrument.sensor, rows=ROWS, cols=COLS)
    instrument = instrument.replace(sensor=sensor)
    reference = draw(instrument, 20_000, depth=0.5, seed=1)
    calibration = hf.calibrate(reference, instrument, distance=0.5)
    counts = draw(instrument, 600, depth=0.9, seed=3)
    image = describe(hf.reconstruct(counts, calibration), calibration)
    yield Work("reconstruct", lambda _: hf.reconstruct(counts, calibration))
    for name, entry in FORMATS.items():
        target = f"scene{entry.endings[0]}"
        yield Work(f"write {name}", lambda folder, t=target: write(image, folder / t) and None)


@contextmanager
def failing_allocation(number: int) -> Iterator[None]:
    """Let one allocation of the interpreter fail."""
    hooks = import_module("_testcapi")  # the interpreter's own tests use it for this
    hooks.set_nomemory(number, number + 1)
    try:
        yield
    finally:
        hooks.remove_mem_hooks()


@contextmanager
def limited_memory(number: int) -> Iterator[None]:
    """Let the process take only a little more memory than it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + number * STEP_BYTES
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


ENDED = {"failed": True, "outcome": "ended", "findings": []}
FAILURES = {"allocations": failing_allocation, "limits": limited_memory}


def run(
    *, fineness: int = FINENESS, only: Container[str] | None = None
) -> tuple[Counter[str], list[str]]:
    """Let memory fail at many places; return outcomes by name, and findings."""
    outcomes: Counter[str] = Counter()
    findings: list[str] = []
    ctypes.CDLL(None).mallopt(*MAPPED)
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as name:
        for work in works():
            if only is not None and work.name not in only:
                continue
            try:
                expected = work.result(_empty(Path(name) / "first"))
            except MissingPackageError:
                continue
            if work.result(_empty(Path(name) / "first")) != expected:
                expected[1] = dict.fromkeys(expected[1])  # its size depends on the time
            for kind in FAILURES:
                _try_all(Path(name), work, expected, kind, fineness, outcomes, findings)
    return outcomes, findings[:MOST_FINDINGS]


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


def _try_all(
    folder: Path,
    work: Work,
    expected: list[Any],
    kind: str,
    fineness: int,
    outcomes: Counter[str],
    findings: list[str],
) -> None:
    passes, number = 0, 0
    while passes < PASSES:
        attempt = partial(_try, _empty(folder / "run"), work, expected, kind, number)
        found = in_child(attempt, folder / "said.json", longest_s=LONGEST_S) or ENDED
        passes = 0 if found["failed"] else passes + 1
        outcomes[found["outcome"]] += found["failed"]
        findings += [f"{work.name}, {kind} {number}: {each}" for each in found["findings"]]
        number += 1 + number // fineness


def _try(folder: Path, work: Work, expected: list[Any], kind: str, number: int) -> dict[str, Any]:
    """Do the work with too little memory, then with enough; return what is wrong."""
    error: Exception | None = None
    result = None
    try:
        with FAILURES[kind](number):
            result = work.do(folder)
    except Exception as raised:
        error = raised
    findings = []
    left = files_in(folder)
    whole = _alike(left, expected[1])
    if left and not whole:
        findings.append(f"{', '.join(left)} left after {error!r}")
    if error is None and not (whole and _plain(result) == expected[0]):
        findings.append("no error, and another result")
    if _unexplained(error):
        findings.append(f"{error!r}, which nobody explained")
    if error is not None:
        again = work.result(_empty(folder))
        if again[0] != expected[0] or not _alike(again[1], expected[1]):
            findings.append(f"another result after {error!r}")
    outcome = "other"
    if isinstance(error, HueflightError):
        outcome = "complete" if left else "refused"
    elif isinstance(error, MemoryError):
        outcome = "uncalled"
    return {"failed": error is not None, "outcome": outcome, "findings": findings}


def _unexplained(error: Exception | None) -> bool:
    """Whether memory ran out within a function of Hueflight, and its error does not say so.

    The call of the function needs memory itself, and what is raised then is the interpreter's.
    """
    if not isinstance(error, MemoryError) or isinstance(error, HueflightError):
        return False
    inside = {str(Path(module.__file__ or "")) for module in (entry_point, formats)}
    return any(frame.filename in inside for frame in traceback.extract_tb(error.__traceback__))


def _alike(left: dict[str, int], expected: dict[str, int | None]) -> bool:
    """Whether the files are the expected ones; None stands for any size."""
    return left.keys() == expected.keys() and all(
        expected[name] in (None, size) for name, size in left.items()
    )


def report(quick: bool) -> Report:
    """Return the figures of the page."""
    outcomes, findings = run(fineness=QUICK_FINENESS, only=QUICK) if quick else run()
    rows = [["runs in which memory ran out", f"{outcomes.total():,}"]]
    rows += [[words, f"{outcomes[name]:,}"] for name, words in OUTCOMES.items()]
    rows.append(["other errors of ours, incomplete files, other results", str(len(findings))])
    head = ["memory runs out while an image is made or written", "number"]
    return Report(table(head, rows), findings)
