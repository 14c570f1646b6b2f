# SPDX-License-Identifier: Apache-2.0
"""The compiled kernels of a copy of the repository, compiled anew for a mutant of C.

What is judged is compiled with ``-O1``, since the compiler would otherwise take longer than the
tests.
"""

from __future__ import annotations

import hashlib
import itertools
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from setuptools import Extension

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "evidence"))

from builds import Build, compile_kernels, extensions


class Kernels:
    """Extension modules of a copy.

    Parameters
    ----------
    tree : Path
        The copy of the repository.
    kept : Path
        Folder for the modules of the original sources, which must be those of the copy.
    """

    def __init__(self, tree: Path, kept: Path) -> None:
        self.made = Build(tree)
        self.kept = kept
        self.extensions = extensions()
        kept.mkdir(parents=True, exist_ok=True)

    def compile_all(self) -> None:
        """Compile the kernels that were not compiled before, and put all into the copy."""
        for extension in self.extensions:
            self._compile_original(extension)

    def _compile_original(self, extension: Extension) -> None:
        if not self._original(extension).exists():
            new = self.kept / "original.so"
            self._compile(extension, new)
            new.replace(self._original(extension))
        shutil.copyfile(self._original(extension), self._place(extension))

    @contextmanager
    def changed(self, path: Path) -> Iterator[str]:
        """Use the kernels of a source that was changed.

        Parameters
        ----------
        path : Path
            The source, in the copy.

        Yields
        ------
        str
            ``"same code"`` if each build has the same instructions and data as before, ``"not
            compiled"`` if there is none, or nothing. Of the builds of a package for several
            processors, the first one that differs is used, and faster ones are taken away.
        """
        packages = self._packages(path)
        try:
            found = {self._use_first_that_differs(builds) for builds in packages.values()}
            yield "not compiled" if "not compiled" in found else min(found)
        finally:
            for extension in itertools.chain.from_iterable(packages.values()):
                shutil.copyfile(self._original(extension), self._place(extension))

    def optimized(self, path: Path) -> str:
        """Return a digest of the instructions and data of the kernels of a source with ``-O2``.

        Parameters
        ----------
        path : Path
            The source, in the copy.
        """
        digest = hashlib.sha256()
        for extension in itertools.chain.from_iterable(self._packages(path).values()):
            new = self.kept / "mutant.so"
            self._compile(extension, new, "-O2")
            digest.update(new.read_bytes())
        return digest.hexdigest()

    def _packages(self, path: Path) -> dict[Path, list[Extension]]:
        """Return the extension modules that a source belongs to, by their folders of sources."""
        shared = path.is_relative_to(self.made.host / "hueflight" / "backend")
        packages: dict[Path, list[Extension]] = {}
        for extension in self.extensions:
            folder = (self.made.folder / extension.sources[0]).parent
            if shared or folder == path.parent:
                packages.setdefault(folder, []).append(extension)
        return packages

    def _use_first_that_differs(self, builds: list[Extension]) -> str:
        for number, extension in enumerate(builds):
            new = self.kept / "mutant.so"
            try:
                self._compile(extension, new)
            except subprocess.CalledProcessError:
                return "not compiled"
            if new.read_bytes() != self._original(extension).read_bytes():
                self._place(extension).unlink()
                shutil.copyfile(new, self._place(extension))
                for faster in builds[number + 1 :]:
                    self._place(faster).unlink()
                return ""
        return "same code"

    def _compile(self, extension: Extension, to: Path, level: str = "-O1") -> None:
        compile_kernels(self.made, extension, "cc", "-w", level, to=to)

    def _original(self, extension: Extension) -> Path:
        return self.kept / f"{extension.name}.so"

    def _place(self, extension: Extension) -> Path:
        return self.made.host.joinpath(*extension.name.split(".")).with_suffix(".abi3.so")
