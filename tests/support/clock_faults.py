# SPDX-License-Identifier: Apache-2.0
"""A wall clock that is set on demand, in a process of its own: the side of ``clock_shim.c``."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

from support.shims import compile_shim


class ClockFaults:
    """Steps of a process's time of day.

    Parameters
    ----------
    build : Path
        Folder for the compiled library.
    control : Path
        File through which the process is told, which is made.
    """

    def __init__(self, build: Path, control: Path) -> None:
        library = compile_shim("clock_shim", build)
        control.write_bytes(bytes(8))
        with control.open("r+b") as file:
            self._control = mmap.mmap(file.fileno(), 0)
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_CONTROL": str(control)}

    def step(self, seconds: int) -> None:
        """Set the clock so many seconds away from the right time."""
        self._control[:] = struct.pack("q", seconds)
