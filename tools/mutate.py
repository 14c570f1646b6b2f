# SPDX-License-Identifier: Apache-2.0
"""Mutation testing of the gateware: does a small fault in a source make a test fail?

    python tools/mutate.py list                   mutants by file
    python tools/mutate.py run --count 200        judge a seeded sample; goes on where it stopped
    python tools/mutate.py run --again survived   judge survivors anew, after tests were added
    python tools/mutate.py page                   write docs/project/mutation.md from the results

Each mutant is one change of one source file, in a copy of the repository. The tests that judge it
are those of `mutation/suites.toml`, the quickest first; the first failure ends its judgment. What
tests take without a mutant is measured when they are first needed, and kept for the next run. A
mutant that no test notices has survived, unless it gives the same netlists as the original or
`mutation/equivalent.toml` states why it does the same.

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
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

from mutation.operators import Mutant, mutants_of
from mutation.page import write_page

T = TypeVar("T")
ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "hdl" / "hueflight_hdl"
HERE = Path(__file__).parent / "mutation"
COPIED = ("hdl", "protocol", "host", "tests", "tools", "docs", "pyproject.toml")
SLACK = 4.0
"""A run may use so many times the processor time of the original, and a minute more."""


@dataclass(frozen=True)
class Suite:
    """Files, and the tests that judge their mutants.

    Parameters
    ----------
    name : str
        Name on the page.
    files : tuple of Path
        Sources.
    tests : tuple of tuple of str
        Arguments of pytest, for one run each.
    """

    name: str
    files: tuple[Path, ...]
    tests: tuple[tuple[str, ...], ...]


def read_suites() -> list[Suite]:
    """Return the suites; each file is in the first one whose prefix it has."""
    suites, taken = [], set()
    for entry in tomllib.loads((HERE / "suites.toml").read_text())["suite"]:
        files = [
            path
            for path in sorted(SOURCES.rglob("*.py"))
            if path.relative_to(SOURCES).as_posix().startswith(tuple(entry["files"]))
            and path.name not in (*entry.get("exclude", ()), "__init__.py")
            and path not in taken
        ]
        taken.update(files)
        suites.append(Suite(entry["name"], tuple(files), tuple(map(tuple, entry["tests"]))))
    return suites


def sample(suites: list[Suite], *, seed: int) -> list[tuple[Suite, Mutant]]:
    """Return all mutants in random order; a sample is the beginning of it."""
    every = [
        (suite, mutant)
        for suite in suites
        for path in suite.files
        for mutant in mutants_of(ROOT, path)
    ]
    return sorted(every, key=lambda pair: _rank(pair[1], seed))


def _rank(mutant: Mutant, seed: int) -> bytes:
    """Return the place of a mutant in the random order; no change of other mutants moves it."""
    return hashlib.sha256(f"{seed} {mutant.key}".encode()).digest()


class Workplace:
    """A copy of the repository in which mutants are tried.

    Parameters
    ----------
    folder : Path
        Where the copy and the cache of compiled simulations are.
    prefix : list of str
        Command in front of each run, for example ``nice``.
    """

    def __init__(self, folder: Path, prefix: list[str]) -> None:
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
        self.version = _digest(self.tree)

    def judge(self, suite: Suite, mutant: Mutant) -> tuple[str, str]:
        """Return what became of a mutant, and the run that noticed it."""
        path = self.tree / mutant.path
        original = path.read_bytes()
        for tests in suite.tests:
            limit = 60 + SLACK * self._seconds(tests)
            kept = set(self.cache.rglob("*"))
            path.write_bytes(mutant.apply(original))
            try:
                if not self._passes(tests, limit=limit):
                    return "killed", " ".join(tests)
            finally:
                path.write_bytes(original)
                for made in set(self.cache.rglob("*")) - kept:
                    if made.is_file():
                        made.unlink()
        original_netlists = self._once("netlists", self._netlists)
        if not original_netlists:
            raise SystemExit("the netlists cannot be made without a mutant")
        path.write_bytes(mutant.apply(original))
        try:
            return ("same netlist" if self._netlists() == original_netlists else "survived"), ""
        finally:
            path.write_bytes(original)

    def _seconds(self, tests: tuple[str, ...]) -> float:
        """Return the processor time of a run of tests without a mutant, measured once."""

        def measure() -> float:
            before = _seconds_of_children()
            if not self._passes(tests, limit=None):
                raise SystemExit(f"{' '.join(tests)}: fails without a mutant")
            return _seconds_of_children() - before

        return self._once(" ".join(tests), measure)

    def _once(self, name: str, measure: Callable[[], T]) -> T:
        """Return what is the same for all mutants of these sources, from an earlier run or now."""
        known = json.loads(self.baselines.read_text()) if self.baselines.exists() else {}
        place = f"{self.version} {name}"
        if place not in known:
            known[place] = measure()
            self.baselines.write_text(json.dumps(known, indent=1))
        return known[place]

    def _passes(self, tests: tuple[str, ...], *, limit: float | None) -> bool:
        """Whether a run of tests passes; one that uses too much processor time does not."""
        bound = "" if limit is None else f"ulimit -t {round(limit)}; "
        # processor time bounds a run, not the clock: others may need the machine
        options = ("-x", "-q", "-p", "no:cacheprovider", "--timeout", "0")
        pytest = (sys.executable, "-m", "pytest", *options, *tests)
        words = [*self.prefix, "sh", "-c", f"{bound}exec {shlex.join(pytest)}"]
        return self._run(words).returncode == 0

    def _netlists(self) -> str:
        """Return a hash of the netlists of the copy, or nothing if it cannot be elaborated."""
        return self._run([sys.executable, str(HERE / "netlist.py")]).stdout

    def _run(self, words: list[str]) -> subprocess.CompletedProcess[str]:
        """Run a command in the copy."""
        folders = (str(self.tree / name) for name in ("protocol", "hdl", "host", "tests"))
        environment = {
            "YOWASP_CACHE_DIR": str(Path.home() / ".cache" / "hueflight" / "yowasp"),
            **os.environ,
            "PYTHONPATH": os.pathsep.join(folders),
            "HUEFLIGHT_CACHE": str(self.cache),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        return subprocess.run(
            words, cwd=self.tree, env=environment, capture_output=True, text=True, check=False
        )


def _digest(tree: Path) -> str:
    """Return a digest of the sources and tests in a copy of the repository."""
    digest = hashlib.sha256()
    for name in ("hdl", "protocol", "host", "tests/hdl", "tests/support"):
        for path in sorted((tree / name).rglob("*.py")):
            digest.update(path.relative_to(tree).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _seconds_of_children() -> float:
    """Return the processor time of all commands so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def judge_sample(arguments: argparse.Namespace) -> None:
    """Judge mutants that have no result yet."""
    results = read_results(arguments.results)
    chosen = sample(read_suites(), seed=arguments.seed)[: arguments.count]
    due = [
        (suite, mutant)
        for suite, mutant in chosen
        if mutant.key not in results or results[mutant.key]["status"] in arguments.again
    ]
    print(f"{len(chosen)} mutants in the sample, {len(due)} to judge", flush=True)
    arguments.results.parent.mkdir(parents=True, exist_ok=True)
    work = Workplace(arguments.folder, arguments.prefix.split())
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
        with arguments.results.open("a") as file:
            file.write(json.dumps(record) + "\n")
        took = time.monotonic() - began
        print(f"{number}/{len(due)} {status} {mutant.path}:{mutant.line} {took:.0f} s", flush=True)


def read_results(path: Path) -> dict[str, dict[str, object]]:
    """Return the last result of each mutant by its key."""
    lines = path.read_text().splitlines() if path.exists() else []
    return {record["key"]: record for record in map(json.loads, lines)}


def list_mutants(arguments: argparse.Namespace) -> None:
    """Print how many mutants each file has."""
    total = 0
    for suite in read_suites():
        for path in suite.files:
            count = len(mutants_of(ROOT, path))
            total += count
            print(f"{count:5}  {path.relative_to(ROOT)}  ({suite.name})")
    print(f"{total:5}  in all; seed {arguments.seed}")


def make_page(arguments: argparse.Namespace) -> None:
    """Write the page of results: of the sample as far as it is judged without a gap."""
    order = [mutant.key for _, mutant in sample(read_suites(), seed=arguments.seed)]
    known = read_results(arguments.results)
    results = [known[key] for key in takewhile(known.__contains__, order)]
    reasons = tomllib.loads((HERE / "equivalent.toml").read_text())
    page = write_page(results, reasons, total=len(order), seed=arguments.seed)
    (ROOT / "docs" / "project" / "mutation.md").write_text(page)


def main() -> None:
    """Read the command line and do what it says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("action", choices=("list", "run", "page"))
    parser.add_argument("--count", type=int, default=200, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument(
        "--minutes", type=float, default=1e6, help="begin no mutant after this time"
    )
    parser.add_argument(
        "--again",
        action="append",
        choices=("killed", "survived", "same netlist"),
        default=[],
        help="judge results with this status anew; may be repeated",
    )
    parser.add_argument("--prefix", default="nice", help="command in front of each run of tests")
    parser.add_argument(
        "--folder",
        type=Path,
        default=ROOT / "build" / "mutation",
        help="where the copy of the repository and the cache are made",
    )
    parser.add_argument(
        "--results",
        type=Path,
        default=ROOT / "docs" / "results" / "mutants.jsonl",
        help="file of results, one line of JSON for each",
    )
    arguments = parser.parse_args()
    {"list": list_mutants, "run": judge_sample, "page": make_page}[arguments.action](arguments)


if __name__ == "__main__":
    main()
