# SPDX-License-Identifier: Apache-2.0
"""Writes Verilog projects for other toolchains, and estimates their resources with yosys."""

from __future__ import annotations

import json
from pathlib import Path

from ..boards.target import Target
from ..toolchain import run_tool
from .build import NAME, prepare
from .open_project import complete_project
from .report import BuildError

_XILINX_SYNTHESIS = {
    "xc3s": "synth_xilinx -family xc3s -ise -flatten",
    "xc6s": "synth_xilinx -family xc6s -ise -flatten",
    "xc7": "synth_xilinx -family xc7 -flatten",
}
_KINDS = {
    "LUT": ("LUT1", "LUT2", "LUT3", "LUT4", "LUT5", "LUT6", "SB_LUT4"),
    "flip-flop": ("FDRE", "FDSE", "FDCE", "FDPE", "FDR", "FDS", "FD", "FDE", "TRELLIS_FF"),
    "block RAM": (
        "RAMB16BWER",
        "RAMB8BWER",
        "RAMB16",
        "RAMB18E1",
        "RAMB36E1",
        "DP16KD",
        "SB_RAM40_4K",
    ),
    "LUT RAM": ("TRELLIS_DPR16X4", "RAM32M", "RAM64M", "RAM32X1D", "RAM64X1D"),
    "carry cell": ("CARRY4", "MUXCY", "XORCY", "CCU2C", "SB_CARRY"),
}


def write_project(target: Target, folder: Path, /, *, constraints: bool = True) -> list[Path]:
    """Write a target's Verilog, constraints and scripts.

    Parameters
    ----------
    target : Target
        Design and board.
    folder : Path
        Output folder; it is created if needed.
    constraints : bool
        True to complete a project for open tools, see `open_project`, which takes a synthesis;
        False where only the Verilog is needed.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    ToolError
        If yosys, which converts RTLIL to Verilog, is not installed or fails.
    """
    commands = prepare(target, folder)
    verilog = folder / f"{NAME}.v"
    if (folder / f"{NAME}.il").exists():
        passes = f"read_rtlil {NAME}.il; proc -nomux -norom; memory_collect; "
        passes += f"write_verilog -norename {verilog.name}"
        run_tool("yosys", "-q", "-p", passes, cwd=folder)
    if not verilog.exists():
        raise BuildError(f"{folder}: no Verilog was written")
    if commands and constraints:
        complete_project(target, commands, folder, NAME)
    return sorted(path for path in folder.iterdir() if path.is_file())


def estimate(target: Target, folder: Path, /) -> dict[str, int]:
    """Return how many cells yosys makes of a project that has been written, by kind.

    It is an estimate: nothing has been packed, placed or routed. It is also written as
    ``counts.json``, for the page of bitstreams.
    """
    if target.family in _XILINX_SYNTHESIS:
        (folder / "blackboxes.v").write_text(target.blackboxes)
        passes = f"read_verilog -lib blackboxes.v; read_verilog {NAME}.v; "
        passes += f"{_XILINX_SYNTHESIS[target.family]} -top {NAME}; "
    else:
        passes = f"script {NAME}.ys; "
    passes += "tee -q -o cells.json stat -json"
    run_tool("yosys", "-q", "-p", passes, cwd=folder)
    cells = json.loads((folder / "cells.json").read_text())["design"]["num_cells_by_type"]
    counted = {kind: sum(cells.get(name, 0) for name in names) for kind, names in _KINDS.items()}
    counted = {kind: number for kind, number in counted.items() if number}
    content = {"design": target.design, "board": target.board, "lanes": target.lanes}
    (folder / "counts.json").write_text(json.dumps({**content, "cells": counted}, indent=2) + "\n")
    return counted
