# SPDX-License-Identifier: Apache-2.0
"""Mutation testing: does a small fault in a source make a test fail?

    python tools/mutate.py list                   mutants by file
    python tools/mutate.py run --count 200        judge a seeded sample; goes on where it stopped
    python tools/mutate.py run --again survived   judge survivors anew, after tests were added
    python tools/mutate.py page                   write docs/project/mutation.md from all results

The sources are those of the gateware, or with `--of host` Python and C from packets to images.
Each mutant is one change of one source file, in a copy of the repository. The tests that judge it
are those of `mutation/suites.toml` or `host_suites.toml`, the quickest first; the first failure
ends its judgment. What tests take without a mutant is measured when they are first needed, and kept
for the next run. A mutant that no test notices has survived, unless it gives the same netlists,
bytecode or compiled kernels as the original, or `mutation/equivalent.toml` states why it does the
same.

The sample is a simple random one: mutants come in the order of a hash of their keys with the seed,
so that a longer sample begins with the shorter one, also after other parts of the sources changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Collection
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

from mutation.kernels import Kernels
from mutation.operators import Mutant
from mutation.page import Judged, write_page
from mutation.python_operators import same_code
from mutation.subjects import GATEWARE, HERE, SUBJECTS, Subject, Suite
from mutation.warm import WarmTests

T = TypeVar("T")
ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "results"
COPIED = ("hdl", "protocol", "host", "tests", "tools", "docs", "pyproject.toml")
SLACK = 4.0
"""A run may use so many times the processor time of the original, and some more."""
PATIENCE = 8.0
"""And so many times that on the clock, since a mutant may wait without end."""


def sample(subject: Subject, suites: list[Suite], *, seed: int) -> list[tuple[Suite, Mutant]]:
    """Return all mutants in random order; a sample is the beginning of it."""
    every = [
        (suite, mutant)
        for suite in suites
        for path in suite.files
        for mutant in subject.mutants_of(ROOT, path)
    ]
    return sorted(every, key=lambda pair: _rank(pair[1], seed))


def _rank(mutant: Mutant, seed: int) -> bytes:
    """Return the place of a mutant in the random order; no change of other mutants moves it."""
    return hashlib.sha256(f"{seed} {mutant.key}".encode()).digest()


class Workplace:
    """A copy of the repository in which mutants are tried.

    Parameters
    ----------
    subject : Subject
        What has mutants.
    folder : Path
        Where the copy and the cache of compiled simulations are.
    prefix : list of str
        Command in front of each run, for example ``nice``.
    """

    def __init__(self, subject: Subject, folder: Path, prefix: list[str]) -> None:
        self.subject = subject
        self.tree = folder / "tree"
        self.cache = folder / "cache"
        self.prefix = prefix
        for name in COPIED:
            source, target = ROOT / name, self.tree / name
            if source.is_dir():
                shutil.rmtree(target, ignore_errors=True)
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copyfile(source, target)
        self.cache.mkdir(parents=True, exist_ok=True)
        self.baselines = folder / "baselines.json"
        self.version = _digest(self.tree, subject)
        self.kernels: Kernels | None = None
        self.warm: WarmTests | None = None
        if subject is not GATEWARE:
            sources = _digest(self.tree, subject, suffixes=(".c", ".h"))
            self.kernels = Kernels(self.tree, folder / "kernels" / sources)
            self.kernels.compile_all()
            self.warm = WarmTests(self.tree, self._environment(), prefix)

    def judge(self, suite: Suite, mutant: Mutant) -> tuple[str, str]:
        """Return what became of a mutant, and the run that noticed it."""
        path = self.tree / mutant.path
        original = path.read_bytes()
        limits = [self.subject.grace + SLACK * self._seconds(tests) for tests in suite.tests]
        if self.kernels is None and not self._once("netlists", self._netlists):
            raise SystemExit("the netlists cannot be made without a mutant")
        changed = mutant.apply(original)
        if path.suffix == ".py" and self.kernels and same_code(original, changed):
            return self.subject.same, ""
        try:
            path.write_bytes(changed)
            if path.suffix == ".py" or self.kernels is None:
                return self._judge(suite, limits)
            with self.kernels.changed(path) as status:
                status, by = (status, "") if status else self._judge(suite, limits)
            if status == "survived" and self._optimized_alike(path, original):
                return self.subject.same, ""
            return status, by
        finally:
            path.write_bytes(original)

    def _optimized_alike(self, path: Path, original: bytes) -> bool:
        """Whether a compiler that optimizes makes the same kernels of a source as before."""
        kernels = self.kernels
        assert kernels
        now = kernels.optimized(path)
        path.write_bytes(original)
        place = f"optimized {path.parent.relative_to(self.tree)}"
        return now == self._once(place, lambda: kernels.optimized(path))

    def _judge(self, suite: Suite, limits: list[float]) -> tuple[str, str]:
        """Run tests, the quickest first, until one of them fails."""
        for tests, limit in zip(suite.tests, limits, strict=True):
            kept = set(self.cache.rglob("*"))
            try:
                if not self._try(tests, limit=limit)[0]:
                    return "killed", " ".join(tests)
            finally:
                for made in set(self.cache.rglob("*")) - kept:
                    if made.is_file():
                        made.unlink()
        if self.kernels is None and self._netlists() == self._once("netlists", self._netlists):
            return self.subject.same, ""
        return "survived", ""

    def _seconds(self, tests: tuple[str, ...]) -> float:
        """Return the processor time of a run of tests without a mutant, measured once."""

        def measure() -> float:
            passed, seconds = self._try(tests, limit=None)
            if not passed:
                raise SystemExit(f"{' '.join(tests)}: fails without a mutant")
            return seconds

        return self._once(" ".join(tests), measure)

    def _once(self, name: str, measure: Callable[[], T]) -> T:
        """Return what is the same for all mutants of these sources, from an earlier run or now."""
        known = json.loads(self.baselines.read_text()) if self.baselines.exists() else {}
        place = f"{self.version} {name}"
        if place not in known:
            known[place] = measure()
            self.baselines.write_text(json.dumps(known, indent=1))
        return known[place]

    def _try(self, tests: tuple[str, ...], *, limit: float | None) -> tuple[bool, float]:
        """Whether a run of tests passes, and its processor time, which `limit` bounds."""
        bound = "" if limit is None else f"ulimit -t {round(limit)}; "
        timeout = limit and PATIENCE * limit
        # processor time bounds a run, not the clock: others may need the machine
        options = ("-x", "-q", "-p", "no:cacheprovider", "--timeout", "0")
        if self.warm:
            return self.warm.run([*options, *tests], limit=limit, timeout=timeout)
        pytest = (sys.executable, "-m", "pytest", *options, *tests)
        words = [*self.prefix, "sh", "-c", f"{bound}exec {shlex.join(pytest)}"]
        before = _seconds_of_children()
        try:
            passed = self._run(words, timeout=timeout).returncode == 0
        except subprocess.TimeoutExpired:
            passed = False
        return passed, _seconds_of_children() - before

    def _netlists(self) -> str:
        """Return a hash of the netlists of the copy, or nothing if it cannot be elaborated."""
        return self._run([sys.executable, str(HERE / "netlist.py")]).stdout

    def _run(
        self, words: list[str], *, timeout: float | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in the copy."""
        return subprocess.run(
            words,
            cwd=self.tree,
            env=self._environment(),
            capture_output=True,
            text=True,
            check=False,
            timeout=timeout,
        )

    def _environment(self) -> dict[str, str]:
        """Return the environment in which the copy is used."""
        folders = (str(self.tree / name) for name in ("protocol", "hdl", "host", "tests"))
        return {
            "YOWASP_CACHE_DIR": str(Path.home() / ".cache" / "hueflight" / "yowasp"),
            **os.environ,
            "PYTHONPATH": os.pathsep.join(folders),
            "HUEFLIGHT_CACHE": str(self.cache),
            "PYTHONDONTWRITEBYTECODE": "1",
        }


def _digest(tree: Path, subject: Subject, suffixes: Collection[str] = ()) -> str:
    """Return a digest of the sources and tests in a copy of the repository."""
    digest = hashlib.sha256()
    for name in subject.digested:
        for path in sorted((tree / name).rglob("*")):
            if path.suffix in (suffixes or subject.mutants):
                digest.update(path.relative_to(tree).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _seconds_of_children() -> float:
    """Return the processor time of all commands so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def judge_sample(arguments: argparse.Namespace) -> None:
    """Judge mutants that have no result yet."""
    subject = SUBJECTS[arguments.of]
    file = arguments.results or RESULTS / subject.results
    results = read_results(file)
    every = subject.read_suites(ROOT)
    suites = [suite for suite in every if suite.name in (arguments.suite or [suite.name])]
    if not suites:
        raise SystemExit(f"no such suite; one of: {', '.join({suite.name for suite in every})}")
    chosen = sample(subject, suites, seed=arguments.seed)[: arguments.count]
    due = [
        (suite, mutant)
        for suite, mutant in chosen
        if mutant.key not in results or results[mutant.key]["status"] in arguments.again
    ]
    print(f"{len(chosen)} mutants in the sample, {len(due)} to judge", flush=True)
    file.parent.mkdir(parents=True, exist_ok=True)
    folder = arguments.folder or ROOT / "build" / "mutation" / subject.name
    work = Workplace(subject, folder, arguments.prefix.split())
    end = time.monotonic() + 60 * arguments.minutes
    for number, (suite, mutant) in enumerate(due, 1):
        if time.monotonic() > end:
            break
        began = time.monotonic()
        status, by = work.judge(suite, mutant)
        record = {
            "key": mutant.key,
            "suite": suite.name,
            "path": mutant.path,
            "line": mutant.line,
            "where": mutant.where,
            "operator": mutant.operator,
            "before": mutant.before,
            "after": mutant.after,
            "status": status,
            "by": by,
        }
        with file.open("a") as lines:
            lines.write(json.dumps(record) + "\n")
        took = time.monotonic() - began
        print(f"{number}/{len(due)} {status} {mutant.path}:{mutant.line} {took:.0f} s", flush=True)
    if work.warm:
        work.warm.close()


def read_results(path: Path) -> dict[str, dict[str, object]]:
    """Return the last result of each mutant by its key, with the status that it had first."""
    lines = path.read_text().splitlines() if path.exists() else []
    first: dict[str, str] = {}
    return {
        record["key"]: {**record, "first": first.setdefault(record["key"], record["status"])}
        for record in map(json.loads, lines)
    }


def list_mutants(arguments: argparse.Namespace) -> None:
    """Print how many mutants each file has."""
    total = 0
    subject = SUBJECTS[arguments.of]
    for suite in subject.read_suites(ROOT):
        for path in suite.files:
            count = len(subject.mutants_of(ROOT, path))
            total += count
            print(f"{count:5}  {path.relative_to(ROOT)}  ({suite.name})")
    print(f"{total:5}  in all; seed {arguments.seed}")


def make_page(arguments: argparse.Namespace) -> None:
    """Write the page of results: of each part's sample as far as it is judged without a gap."""
    reasons = tomllib.loads((HERE / "equivalent.toml").read_text())
    judged = []
    for subject in SUBJECTS.values():
        known = read_results(RESULTS / subject.results)
        every = sample(subject, subject.read_suites(ROOT), seed=arguments.seed)
        order: dict[str, list[str]] = {}
        for suite, mutant in every:
            order.setdefault(suite.name, []).append(mutant.key)
        results = {
            name: [known[key] for key in takewhile(known.__contains__, keys)]
            for name, keys in order.items()
        }
        totals = {name: len(keys) for name, keys in order.items()}
        first = list(takewhile(known.__contains__, (mutant.key for _, mutant in every)))
        simple = len(first) == sum(map(len, results.values()))
        judged.append(Judged(subject, results, totals, simple))
    page = write_page(judged, reasons, seed=arguments.seed)
    (ROOT / "docs" / "project" / "mutation.md").write_text(page)


def main() -> None:
    """Read the command line and do what it says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("action", choices=("list", "run", "page"))
    parser.add_argument("--of", choices=SUBJECTS, default="gateware", help="sources")
    parser.add_argument("--count", type=int, default=200, help="mutants in the sample")
    parser.add_argument(
        "--suite", action="append", help="judge mutants of this part alone; may be repeated"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument(
        "--minutes", type=float, default=1e6, help="begin no mutant after this time"
    )
    parser.add_argument(
        "--again",
        action="append",
        choices=("killed", "survived", "same netlist", "same code", "not compiled"),
        default=[],
        help="judge results with this status anew; may be repeated",
    )
    parser.add_argument("--prefix", default="nice", help="command in front of each run of tests")
    parser.add_argument(
        "--folder",
        type=Path,
        help="where the copy of the repository and the cache are made; by default in build/",
    )
    parser.add_argument(
        "--results",
        type=Path,
        help="file of results, one line of JSON for each; by default one in docs/results",
    )
    arguments = parser.parse_args()
    {"list": list_mutants, "run": judge_sample, "page": make_page}[arguments.action](arguments)


if __name__ == "__main__":
    main()
