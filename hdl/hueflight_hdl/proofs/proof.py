"""A statement about gateware, and the tools that prove it for every input there can be."""

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
    """A statement that does not hold, or that could not be proved."""


@dataclass(frozen=True)
class Proof:
    """A statement to be proved.

    Parameters
    ----------
    name : str
        What it is called by.
    statement : str
        What holds, in words.
    harness : callable
        Makes the component with the assertions. Its inputs are free: they do whatever its
        assumptions allow, in every clock. It begins as it is after configuration.
    depth : int
        Clocks of the induction, or clocks that are looked at from configuration on.
    induction : bool
        Whether it is proved for all time by k-induction, or for the first `depth` clocks.
    """

    name: str
    statement: str
    harness: Callable[[], wiring.Component]
    depth: int
    induction: bool = True

    @property
    def kind(self) -> str:
        """How it is proved, in words."""
        if self.induction:
            return f"for all time, by {self.depth}-induction"
        return f"for the first {self.depth} clocks"


def prove(proof: Proof, /) -> None:
    """Prove a statement.

    Raises
    ------
    ProofError
        If it does not hold; the message ends with what failed and in which clock.
    ToolError
        If a tool is not there.
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
            raise ProofError(f"not proved: {proof.statement} ({proof.kind})\n{error}") from error


def proof_source(harness: wiring.Component, /) -> str:
    """Return a harness as RTLIL; its inputs are ports, and it starts from its reset values."""
    top = Module()
    top.domains += (domain := ClockDomain("sync", reset_less=True))
    top.submodules.harness = harness
    ports: list[Value] = [domain.clk]
    for _, _, value in harness.signature.flatten(harness):
        signal = Value.cast(value)
        if isinstance(signal, Signal) and len(signal):
            ports.append(signal)
    return rtlil.convert(top, ports=ports)
