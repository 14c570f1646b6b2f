# SPDX-License-Identifier: Apache-2.0
"""A property of the gateware, and its formal verification with yosys, SBY and yices."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from amaranth.back import rtlil
from amaranth.hdl import ClockDomain, Module, Signal, Value
from amaranth.lib import wiring

from hueflight_protocol.errors import HueflightError

from ..toolchain import ToolError, cache_directory, run_tool

_JOB = """\
[options]
mode {mode}
depth {depth}

[engines]
smtbmc yices

[script]
read_rtlil design.il
prep -top top
# an induction begins with any contents of a memory, even of one that is never written
memory_map -rom-only

[files]
design.il
"""


class ProofError(HueflightError):
    """A property does not hold, or its verification did not finish."""


@dataclass(frozen=True)
class Proof:
    """A property to be verified formally.

    Parameters
    ----------
    name : str
        Name on the command line.
    statement : str
        The property in words.
    harness : callable
        Returns the component with the assertions. Its inputs are free: in every clock they take
        any value that its assumptions allow. It starts in the state after configuration.
    depth : int
        Length of the induction in clocks, or number of clocks checked after configuration.
    induction : bool
        True if the property is verified for all time by k-induction, False if it is checked for
        the first `depth` clocks only (bounded model checking).
    """

    name: str
    statement: str
    harness: Callable[[], wiring.Component]
    depth: int
    induction: bool = True

    @property
    def kind(self) -> str:
        """How the property is verified, in words."""
        if self.induction:
            return f"for all time, by {self.depth}-induction"
        return f"for the first {self.depth} clocks"


def prove(proof: Proof, /) -> None:
    """Verify a property.

    Parameters
    ----------
    proof : Proof
        The property.

    Raises
    ------
    ProofError
        If it does not hold; the message ends with the assertion that failed and its clock.
    ToolError
        If a tool is not installed.
    """
    text = proof_source(proof.harness())
    folder = cache_directory() / "proofs"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        work = Path(made)
        (work / "design.il").write_text(text)
        mode = "prove" if proof.induction else "bmc"
        (work / "job.sby").write_text(_JOB.format(mode=mode, depth=proof.depth))
        try:
            run_tool("sby", "-f", "job.sby", cwd=work)
        except ToolError as error:
            if not (work / "job").is_dir():
                raise
            raise ProofError(f"not verified: {proof.statement} ({proof.kind})\n{error}") from error


def proof_source(harness: wiring.Component, /) -> str:
    """Return a harness as RTLIL, with its inputs as ports and reset values as initial state."""
    top = Module()
    top.domains += (domain := ClockDomain("sync", reset_less=True))
    top.submodules.harness = harness
    ports: list[Value] = [domain.clk]
    for _, _, value in harness.signature.flatten(harness):
        signal = Value.cast(value)
        if isinstance(signal, Signal) and len(signal):
            ports.append(signal)
    return rtlil.convert(top, ports=ports)
