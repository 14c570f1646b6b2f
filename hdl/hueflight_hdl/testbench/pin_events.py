# SPDX-License-Identifier: Apache-2.0
"""Verilog with models of a family's primitives, driven by events at its pins in picoseconds."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..toolchain import run_tool
from .board import MODELS, BoardError

_WRAPPER = """\
module testbench;
    reg [{last_in}:0] pins = 0;
    wire [{last_out}:0] outputs;
    integer file, count;
    longint at;
    reg [{last_in}:0] next;
    top top ({connections});
    always @(outputs) $display("%0d %h", $time, outputs);
    initial begin
        file = $fopen("events.txt", "r");
        count = $fscanf(file, "%d %h", at, next);
        while (count == 2) begin
            #(at - $time);
            pins = next;
            count = $fscanf(file, "%d %h", at, next);
        end
        $finish;
    end
endmodule
"""
_MODE = 'extern "C" int pll_mode() { return 0; }\n'
_OPTIONS = ("--binary", "--timing", "-Wno-fatal", "-Wno-lint", "-Wno-style")


class PinBench:
    """A design whose inputs and outputs are gathered in two words.

    Parameters
    ----------
    verilog : str
        A module ``top``.
    inputs, outputs : mapping of str to int
        Widths of its ports; in a word the first port is lowest.
    family : str
        Family of the FPGA, one of `board.FAMILIES`.
    """

    def __init__(
        self,
        verilog: str,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int],
        *,
        family: str = "ecp5",
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="hueflight-pins-")
        work = Path(self._folder.name)
        wrapper = _WRAPPER.format(
            last_in=sum(inputs.values()) - 1,
            last_out=sum(outputs.values()) - 1,
            connections=", ".join([*_slices(inputs, "pins"), *_slices(outputs, "outputs")]),
        )
        (work / "top.v").write_text(verilog)
        (work / "testbench.sv").write_text(wrapper)
        (work / "mode.cc").write_text(_MODE)
        (work / f"{family}.sv").write_text((MODELS / f"{family}.sv").read_text())
        names = ("top.v", "testbench.sv", f"{family}.sv", "mode.cc")
        timing = ("--timescale", "1ps/1ps", "--top-module", "testbench", "-CFLAGS", "-O1")
        run_tool("verilator", *_OPTIONS, *timing, "--Mdir", "obj", "-o", "run", *names, cwd=work)

    def run(self, events: Iterable[tuple[int, int]], /) -> list[tuple[int, int]]:
        """Return the changes of the outputs: time in ps, and the word.

        Parameters
        ----------
        events : iterable of (int, int)
            Times in ps, ascending, and the word of all inputs from then on.

        Raises
        ------
        BoardError
            If the simulation fails.
        """
        work = Path(self._folder.name)
        lines = [f"{time} {word:x}" for time, word in events]
        (work / "events.txt").write_text("\n".join(lines) + "\n")
        finished = subprocess.run(
            [work / "obj" / "run"], cwd=work, capture_output=True, text=True, check=False
        )
        if finished.returncode:
            raise BoardError(f"the simulation failed: {finished.stderr[-500:]}")
        pairs = [line.split() for line in finished.stdout.splitlines() if line[:1].isdigit()]
        return [(int(time), int(word, 16)) for time, word in pairs]

    def close(self) -> None:
        """Remove the compiled program."""
        self._folder.cleanup()


def _slices(widths: Mapping[str, int], word: str) -> list[str]:
    """Return connections of ports to slices of a word."""
    found, at = [], 0
    for name, width in widths.items():
        found.append(f".{name}({word}[{at + width - 1}:{at}])")
        at += width
    return found
