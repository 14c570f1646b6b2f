# SPDX-License-Identifier: Apache-2.0
"""A disk that fails on demand, under a process of its own: the Python side of ``disk_shim.c``."""

from __future__ import annotations

import errno
import mmap
import struct
from pathlib import Path

from support.shims import compile_shim

NAMES = ("write", "create", "sync", "rename", "room", "share")


class DiskFaults:
    """Faults of the files below a folder.

    Parameters
    ----------
    build : Path
        Folder for the compiled library.
    folder : Path
        Folder whose files fail.
    control : Path, optional
        File through which the process is told, which is made; by default in `build`.
    """

    def __init__(self, build: Path, folder: Path, control: Path | None = None) -> None:
        library = compile_shim("disk_shim", build)
        control = control or build / "control"
        control.write_bytes(bytes(4 * len(NAMES)))
        with control.open("r+b") as file:
            self._control = mmap.mmap(file.fileno(), 0)
        self.environment = {
            "LD_PRELOAD": str(library),
            "FAULT_FOLDER": str(folder),
            "FAULT_CONTROL": str(control),
        }

    def fail(self, *names: str, error: int = errno.EIO, share: float = 0.0) -> None:
        """Have these calls fail, all of them or a share, and no others."""
        numbers = [error if name in names else 0 for name in NAMES[:-1]]
        self._control[:] = struct.pack(f"{len(NAMES)}i", *numbers, round(1000 * share))

    def heal(self) -> None:
        """Have no call fail."""
        self.fail()
