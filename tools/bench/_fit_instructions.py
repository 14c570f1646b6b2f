# SPDX-License-Identifier: Apache-2.0
"""Instructions of the joint fit per pixel by callgrind, which are the same on every run."""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from _measure import table
from numpy.typing import NDArray

from hueflight.fit import solver
from hueflight.fit.reference import FitOptions
from hueflight.fit.tables import ModelTables

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGES = ROOT / "host" / "hueflight"
ALIGNED = 64  #: bytes, as `_fit_instructions.c` reads them
#: lanes, and the processor that is compiled for; callgrind knows no vectors of 512 bits
BUILDS = {8: ["-march=x86-64-v3"], 4: []}


class _Recorder:
    """Stands in for the compiled module and keeps the arguments of its fit."""

    def __init__(self) -> None:
        self.arguments: tuple[NDArray[Any], ...] = ()

    def fit(self, *buffers: NDArray[Any]) -> None:
        """Keep the arguments."""
        self.arguments = buffers


def arguments_of(
    light: NDArray[np.uint16], offsets_ns: NDArray[np.float64], tables: ModelTables, *, tests: bool
) -> bytes:
    """Return the arguments of a fit as `_fit_instructions.c` reads them."""
    recorder = _Recorder()
    compiled, solver.compiled_kernel = solver.compiled_kernel, lambda _bands=1: recorder
    try:
        dense = np.ascontiguousarray(light, np.uint16)
        solver.fit_pixels(dense, offsets_ns, tables, FitOptions(assessment=tests))
    finally:
        solver.compiled_kernel = compiled
    parts = []
    for buffer in recorder.arguments:
        data = buffer.tobytes()
        parts.append(np.int64(len(data)).tobytes().ljust(ALIGNED, b"\0"))
        parts.append(data.ljust(-(-len(data) // ALIGNED) * ALIGNED, b"\0"))
    return b"".join(parts)


def built(folder: Path, lanes: int) -> Path:
    """Compile the fit for so many lanes, with a program around it."""
    program = folder / f"fit_{lanes}"
    of_python = sysconfig.get_config_var
    subprocess.run(
        [
            *("gcc", "-O3", "-g", "-fno-math-errno", "-fno-trapping-math", *BUILDS[lanes]),
            *(
                f"-DLANES={lanes}",
                f"-I{PACKAGES / 'fit' / '_c'}",
                f"-I{PACKAGES / 'backend' / '_c'}",
            ),
            *(f"-I{sysconfig.get_path('include')}", str(Path(__file__).with_suffix(".c"))),
            *("-o", str(program), f"-L{of_python('LIBDIR')}", f"-Wl,-rpath,{of_python('LIBDIR')}"),
            *(f"-lpython{of_python('LDVERSION')}", "-lm"),
        ],
        check=True,
    )
    return program


def collected(program: Path, arguments: Path) -> int:
    """Run a program under callgrind; return the instructions of its fit."""
    out = arguments.with_suffix(".callgrind")
    subprocess.run(
        [
            *("valgrind", "-q", "--tool=callgrind", f"--callgrind-out-file={out}"),
            *("--toggle-collect=measured_fit*", str(program), str(arguments)),
        ],
        check=True,
        capture_output=True,
    )
    summary = next(line for line in out.read_text().splitlines() if line.startswith("summary:"))
    return int(summary.split()[1])


def instructions(
    lights: dict[str, NDArray[np.uint16]],
    offsets_ns: NDArray[np.float64],
    tables: ModelTables,
    *,
    gate: float | None,
) -> None:
    """Print the instructions per pixel of each build for each light, with and without tests.

    With a gate only the first build and the first light are counted, and the program ends with an
    error where these take more.
    """
    if shutil.which("valgrind") is None or shutil.which("gcc") is None:
        print("instructions: need valgrind and gcc, which are not both here")
        if gate is not None:
            raise SystemExit(1)
        return
    builds = list(BUILDS)
    if gate is not None:
        builds, lights = builds[:1], dict(list(lights.items())[:1])
    rows, found = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        programs = {lanes: built(folder, lanes) for lanes in builds}
        for photons, light in lights.items():
            counts: dict[tuple[int, bool], float] = {}
            for tests in (True, False):
                arguments = folder / "fit"
                arguments.write_bytes(arguments_of(light, offsets_ns, tables, tests=tests))
                for lanes, program in programs.items():
                    counts[lanes, tests] = collected(program, arguments) / len(light)
            for lanes in builds:
                whole, plain = counts[lanes, True], counts[lanes, False]
                found.append(whole)
                shown = f"{whole:.0f}", f"{plain:.0f}", f"{whole / plain - 1:.1%}"
                rows.append([photons, f"{lanes}", *shown])
    print("\n## Instructions of the joint fit per pixel (callgrind)\n")
    print(table(["photons", "lanes", "with tests", "without", "tests cost"], rows))
    if gate is not None and found[0] > gate:
        raise SystemExit(f"the fit takes {found[0]:.0f} instructions per pixel, over {gate:.0f}")
