# SPDX-License-Identifier: Apache-2.0
"""Branch coverage of the packages from packets to images, in Python and in C, by their own tests.

The kernels are compiled with clang's coverage of source text: each condition of an expression is
a branch that must have been true and false. Python's branches are measured by coverage.py. What
is not covered is listed by file and line, with its reason where `gaps.toml` states one; the
percentages count all branches, also those with a reason.

The kernels of ingest choose between paths by what the processor supports. Their tests run again
with kernels that were told that it supports less.

What the tests of a package covered is kept in `build/evidence/coverage` until a source changes:
`coverage:NAME` runs the tests of one package again and shows all that is kept.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from builds import Build, build, compile_kernels, extensions
from covered_branches import File, c_files, python_files
from report import ROOT, Report, table

PACKAGES = {
    "protocol": "protocol/hueflight_protocol",
    "ingest": "host/hueflight/ingest",
    "recording": "host/hueflight/recording",
    "fit": "host/hueflight/fit",
    "reconstruction": "host/hueflight/reconstruction",
}
TESTS = {
    "protocol": ["tests/protocol"],
    "ingest": ["tests/host/ingest"],
    "recording": ["tests/host/recording", "tests/system/evidence/test_power_cuts.py"],
    "fit": ["tests/host/fit", "tests/system/evidence/test_kernel_arguments.py"],
    "reconstruction": ["tests/host/reconstruction"],
}
PARTS = tuple(TESTS)
INGEST = "hueflight.ingest._kernels"
KERNEL_TESTS = [f"tests/host/ingest/test_{name}.py" for name in ("kernels", "broken_rules")]
PROCESSORS = {
    "plain": "__builtin_cpu_supports(name)=0",
    "without-avx512": '__builtin_cpu_supports(name)=(__builtin_strncmp(name, "avx512", 6) != 0)',
}
"""Processors whose paths the tests of the kernels take too, as a macro for the compiler."""
FLAGS = ("-O1", "-g", "-fprofile-instr-generate", "-fcoverage-mapping")
LIMITS = {"Python": 0.95, "C": 0.98}
OWN_LIMITS = {("recording", "Python"): 0.98}
WORK = ROOT / "build" / "evidence" / "coverage"
REASONS = Path(__file__).with_name("gaps.toml")


def report(quick: bool, part: str | None = None) -> Report:
    """Return the figures of the page; `quick` or `part` runs the tests of one package."""
    made = _build()
    names = [part or "ingest"] if quick or part else PARTS
    for name in names:
        run_tests(made, name)
    return summary(made)


def _build() -> Build:
    """Return a copy of the present sources, with what earlier tests of the same covered."""
    made = Build(WORK / "tree")
    kernels = _checksum(path for path in _sources(ROOT / "host") if path.suffix != ".py")
    if _noted("kernels") != kernels:
        shutil.rmtree(WORK, ignore_errors=True)
        build(made.folder, "clang", *FLAGS)
        (ingest,) = (each for each in extensions() if each.name == INGEST)
        for name, supports in PROCESSORS.items():
            to = WORK / f"{name}.so"
            compile_kernels(made, ingest, "clang", *FLAGS, f"-D{supports}", to=to)
        _note("kernels", kernels)
    made.update()
    packages = _checksum(path for each in PACKAGES.values() for path in _sources(ROOT / each))
    if _noted("packages") != packages:
        for name in PARTS:
            shutil.rmtree(WORK / name, ignore_errors=True)
        _note("packages", packages)
    return made


def _sources(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.suffix in (".py", ".c", ".h"))


def _checksum(paths: Iterable[Path]) -> str:
    found = hashlib.sha256()
    for path in paths:
        found.update(str(path).encode() + path.read_bytes())
    return found.hexdigest()


def _noted(name: str) -> str:
    """Return the checksum of the sources of the last run, if there was one."""
    note = WORK / f"{name}.sha256"
    return note.read_text() if note.exists() else ""


def _note(name: str, checksum: str) -> None:
    (WORK / f"{name}.sha256").write_text(checksum)


def run_tests(made: Build, name: str) -> None:
    """Run the tests of a package, which must pass, and keep what they covered."""
    kept = WORK / name
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir()
    _run(made, kept, TESTS[name])
    if name == "ingest":
        for processor in PROCESSORS:
            with _kernels_for(made, processor):
                _run(made, kept, KERNEL_TESTS)


@contextmanager
def _kernels_for(made: Build, processor: str) -> Iterator[None]:
    """Exchange the kernels of ingest for those that take the paths of another processor."""
    module = made.folder.joinpath("host", *INGEST.split(".")).with_suffix(".abi3.so")
    own = module.rename(WORK / "own.so")
    shutil.copy(WORK / f"{processor}.so", module)
    try:
        yield
    finally:
        own.replace(module)


def _run(made: Build, kept: Path, tests: list[str]) -> None:
    environment = made.environment(
        LLVM_PROFILE_FILE=str(kept / "%p.profraw"), COVERAGE_FILE=str(kept / "python")
    )
    del environment["HUEFLIGHT_KERNELS"]  # the tests choose
    sources = ",".join(str(_in_copy(made, path)) for path in PACKAGES.values())
    coverage = [sys.executable, "-m", "coverage", "run", "--branch", "--parallel-mode"]
    pytest = ["-m", "pytest", "-q", "-p", "no:cacheprovider", *tests]
    subprocess.run(
        [*coverage, f"--source={sources}", *pytest], cwd=ROOT, env=environment, check=True
    )


def _in_copy(made: Build, path: str) -> Path:
    """Return where a folder is that the tests import: the host in the copy, others in place."""
    return (made.folder if path.startswith("host/") else ROOT) / path


def summary(made: Build) -> Report:
    """Return the figures of all packages whose tests have run."""
    reasons = tomllib.loads(REASONS.read_text("utf-8"))
    parts = {"Python": python_files(made, WORK), "C": c_files(made, WORK)}
    rows, findings, gaps = [], [], []
    for language, files in parts.items():
        for name in filter(lambda name: (WORK / name).exists(), PACKAGES):
            folder = PACKAGES[name] + "/"
            own = {path: file for path, file in files.items() if path.startswith(folder)}
            branches = sum(file.branches for file in own.values())
            if not branches:
                continue
            share = sum(file.covered for file in own.values()) / branches
            rows.append([f"{name}, {language}", f"{branches:,}", f"{share:.1%}"])
            limit = OWN_LIMITS.get((name, language), LIMITS[language])
            if share < limit:
                findings.append(
                    f"{name}, {language}: {share:.2%} of the branches, limit {limit:.0%}"
                )
            gaps += [row for path, file in own.items() for row in _gaps(made, path, file, reasons)]
    text = table(["branches", "number", "covered"], rows)
    unnamed = sum(not reason for *_, reason in gaps)
    text += (
        f"\n{len(gaps)} lines have a branch that no test takes; {unnamed} of them have no reason "
    )
    text += "in `tools/evidence/gaps.toml`.\n\n"
    return Report(text + table(["place", "source", "reason"], gaps), findings)


def _gaps(
    made: Build, path: str, file: File, reasons: dict[str, dict[str, str]]
) -> Iterator[list[str]]:
    lines = _in_copy(made, path).read_text("utf-8").splitlines()
    known = reasons.get(path, {})
    for number in sorted(file.missing):
        source = lines[number - 1].strip()
        place = path.removeprefix("host/hueflight/").removeprefix("protocol/")
        shown = source.replace("|", "\\|").replace("`", "'")
        yield [f"{place}:{number}", f"`{shown}`", known.get(source, "")]
