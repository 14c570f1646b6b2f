# SPDX-License-Identifier: Apache-2.0
"""Small C libraries that are loaded into a process to make its calls fail."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

FOLDER = Path(__file__).parent


def compile_shim(name: str, build: Path) -> Path:
    """The compiled library of ``NAME.c``, made again only if the source is newer."""
    source, library = FOLDER / f"{name}.c", build / f"{name}.so"
    if library.exists() and library.stat().st_mtime > source.stat().st_mtime:
        return library
    compiler = shutil.which("cc") or shutil.which("gcc")
    assert compiler is not None, "a C compiler is needed"
    build.mkdir(parents=True, exist_ok=True)
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return library
