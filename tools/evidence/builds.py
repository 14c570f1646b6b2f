# SPDX-License-Identifier: Apache-2.0
"""Copies of the host software whose kernels are compiled for a measurement."""

from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sysconfig
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from report import ROOT
from setuptools import Extension

from hueflight.backend import KERNELS

PORTABLE = tuple(kernel.builds[-1] for kernel in KERNELS.values())
"""Of each kernel the module that runs on every processor."""
_LEFT_OUT = shutil.ignore_patterns("*.so", "__pycache__")


@dataclass(frozen=True)
class Build:
    """A copy of the packages of the host with kernels of its own.

    Attributes
    ----------
    folder : Path
        The copy; ``folder / "host"`` holds the packages.
    """

    folder: Path

    @property
    def host(self) -> Path:
        """Folder of the packages."""
        return self.folder / "host"

    def environment(self, **more: str) -> dict[str, str]:
        """Return the environment in which Python loads this copy and must use its kernels."""
        paths = [self.host, ROOT / "protocol", ROOT / "hdl", ROOT / "tools" / "evidence"]
        own = {"PYTHONPATH": os.pathsep.join(map(str, paths)), "HUEFLIGHT_KERNELS": "c"}
        return {**os.environ, **own, "PYTHONDONTWRITEBYTECODE": "1", **more}

    def update(self) -> None:
        """Bring all but the kernels up to date."""
        for path in self.host.rglob("*.py"):
            if not (ROOT / path.relative_to(self.folder)).exists():
                path.unlink()
        shutil.copytree(ROOT / "host", self.host, ignore=_LEFT_OUT, dirs_exist_ok=True)


def extensions() -> list[Extension]:
    """Return the extension modules that setup.py declares."""
    with mock.patch("setuptools.setup") as setup, chdir(ROOT):
        runpy.run_path("setup.py")
    return setup.call_args.kwargs["ext_modules"]


def build(folder: Path, compiler: str, *flags: str, only: tuple[str, ...] = ()) -> Build:
    """Copy the host's packages and compile the kernels, or those whose names are in `only`."""
    made = Build(folder)
    made.update()
    for extension in extensions():
        if not only or extension.name in only:
            compile_kernels(made, extension, compiler, *flags)
    return made


def compile_kernels(
    made: Build, extension: Extension, compiler: str, *flags: str, to: Path | None = None
) -> None:
    """Compile an extension module in a copy, to its place or to another file."""
    where = to or made.folder.joinpath("host", *extension.name.split(".")).with_suffix(".abi3.so")
    command = [
        *(compiler, *extension.extra_compile_args, *flags, "-fPIC", "-shared"),
        f"-I{sysconfig.get_path('include')}",
        *(f"-I{folder}" for folder in extension.include_dirs),
        *(f"-D{name}={value}" for name, value in extension.define_macros),
        *(*extension.sources, "-o", str(where)),
    ]
    subprocess.run(command, check=True, cwd=made.folder)


def runtime(compiler: str, name: str) -> str:
    """Return the path of a library that comes with a compiler."""
    command = [compiler, f"-print-file-name={name}"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
