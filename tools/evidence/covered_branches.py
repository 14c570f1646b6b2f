# SPDX-License-Identifier: Apache-2.0
"""Which branches of a source file the tests have taken, from coverage.py and from clang."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from builds import Build
from report import ROOT


@dataclass
class File:
    """Branches of a source file.

    Attributes
    ----------
    branches, covered : int
        Number of branches, and of those that the tests take.
    missing : set of int
        Lines with branches that they do not take.
    """

    branches: int = 0
    covered: int = 0
    missing: set[int] = field(default_factory=set)


def python_files(made: Build, work: Path) -> dict[str, File]:
    """Return the branches of Python by path, from the data in the folders of `work`."""
    data = str(work / "python")
    command = [sys.executable, "-m", "coverage"]
    parts = sorted(map(str, work.glob("*/python.*")))
    subprocess.run([*command, "combine", "-q", "--keep", f"--data-file={data}", *parts], check=True)
    out = work / "summary.json"
    subprocess.run([*command, "json", "-q", f"--data-file={data}", "-o", str(out)], check=True)
    files = {}
    for name, found in json.loads(out.read_text())["files"].items():
        totals = found["summary"]
        files[_path(made, name)] = File(
            totals["num_branches"],
            totals["covered_branches"],
            {line for line, _ in found["missing_branches"]},
        )
    return files


def c_files(made: Build, work: Path) -> dict[str, File]:
    """Return the branches of C by path: of each condition the ways true and false."""
    profile = work / "c.profdata"
    raw = sorted(map(str, work.glob("*/*.profraw")))
    if not raw:
        return {}
    subprocess.run([tool("llvm-profdata"), "merge", *raw, "-o", profile], check=True)
    counts: dict[tuple[str, int, int], list[int]] = defaultdict(lambda: [0, 0])
    for library in sorted(made.host.rglob("_kernels*.so")):
        command = [tool("llvm-cov"), "export", f"-instr-profile={profile}", library]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        for function in json.loads(done.stdout)["data"][0]["functions"]:
            for branch in function["branches"]:
                name = Path(function["filenames"][branch[6]])
                if name.is_relative_to(made.folder):  # not of the interpreter's headers
                    _add(counts, _path(made, str(name)), branch)
    files: dict[str, File] = defaultdict(File)
    for (path, line, _), (true, false) in counts.items():
        file = files[path]
        file.branches += 2
        file.covered += bool(true) + bool(false)
        if not (true and false):
            file.missing.add(line)
    return files


def _add(counts: dict[tuple[str, int, int], list[int]], path: str, branch: list[int]) -> None:
    """Add up a condition over all functions and libraries that contain it."""
    line, column, _, _, true, false = branch[:6]
    both = counts[path, line, column]
    both[0] += true
    both[1] += false


def _path(made: Build, name: str) -> str:
    """Return the path of a source in the project."""
    path = (ROOT / name).resolve()
    folder = made.folder if path.is_relative_to(made.folder) else ROOT
    return path.relative_to(folder).as_posix()


def tool(name: str) -> str:
    """Return the path of a program of LLVM that fits the compiler."""
    command = ["clang", f"-print-prog-name={name}"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
