# SPDX-License-Identifier: Apache-2.0
"""What mutants are made of: the gateware, or the software from packets to images."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mutation.c_operators import c_mutants
from mutation.operators import Mutant, mutants_of
from mutation.python_operators import python_mutants

HERE = Path(__file__).parent


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


@dataclass(frozen=True)
class Subject:
    """Sources that have mutants.

    Parameters
    ----------
    name : str
        What the command line calls it.
    title : str
        Title on the page.
    folder : str
        Folder to which the files of suites are relative.
    suites : str
        File of suites.
    results : str
        File of results in docs/results.
    mutants : dict of str to callable
        Functions that make the mutants of a file, by its suffix.
    digested : tuple of str
        Folders of the sources and tests on which measured times depend.
    same : str
        Status of a mutant that was found to do the same.
    grace : float
        Seconds of the processor that a run of tests may take in addition.
    """

    name: str
    title: str
    folder: str
    suites: str
    results: str
    mutants: dict[str, Callable[[Path, Path], list[Mutant]]]
    digested: tuple[str, ...]
    same: str
    grace: float

    def read_suites(self, root: Path) -> list[Suite]:
        """Return the suites; each file is in the first one whose prefix it has.

        Parameters
        ----------
        root : Path
            Root of the repository.
        """
        folder = root / self.folder
        every = [path for path in sorted(folder.rglob("*")) if path.suffix in self.mutants]
        suites, taken = [], set()
        for entry in tomllib.loads((HERE / self.suites).read_text())["suite"]:
            files = [
                path
                for path in every
                if path.relative_to(folder).as_posix().startswith(tuple(entry["files"]))
                and path.name not in (*entry.get("exclude", ()), "__init__.py")
                and path not in taken
            ]
            taken.update(files)
            suites.append(Suite(entry["name"], tuple(files), tuple(map(tuple, entry["tests"]))))
        return suites

    def mutants_of(self, root: Path, path: Path) -> list[Mutant]:
        """Return the mutants of a file.

        Parameters
        ----------
        root : Path
            Root of the repository.
        path : Path
            The file.
        """
        return self.mutants[path.suffix](root, path)


GATEWARE = Subject(
    name="gateware",
    title="Gateware",
    folder="hdl/hueflight_hdl",
    suites="suites.toml",
    results="mutants.jsonl",
    mutants={".py": mutants_of},
    digested=("hdl", "protocol", "host", "tests/hdl", "tests/support"),
    same="same netlist",
    grace=60,
)
HOST = Subject(
    name="host",
    title="From packets to images",
    folder="",
    suites="host_suites.toml",
    results="mutants-host.jsonl",
    mutants={".py": python_mutants, ".c": c_mutants, ".h": c_mutants},
    digested=("protocol", "host", "tests/protocol", "tests/host", "tests/support"),
    same="same code",
    grace=20,
)
SUBJECTS = {subject.name: subject for subject in (GATEWARE, HOST)}
