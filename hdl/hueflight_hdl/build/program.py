# SPDX-License-Identifier: Apache-2.0
"""Loads a bitstream into a board with openFPGALoader or ecpprog."""

from __future__ import annotations

from pathlib import Path

from ..boards.target import Target
from ..toolchain import find_tool, require_tool, run_tool
from .report import BuildError


def loading_command(target: Target, bitstream: str, /) -> list[str]:
    """Return the tool that loads a bitstream into the FPGA until power-off, and its arguments.

    Parameters
    ----------
    target : Target
        Design and board.
    bitstream : str
        Name of the file.

    Returns
    -------
    list of str
        openFPGALoader with the board's cable, or ecpprog for ECP5 boards where it alone is
        installed.

    Raises
    ------
    BuildError
        If the board has no known cable.
    ToolError
        If no tool is installed; the message names both.
    """
    if not target.loader:
        raise BuildError(
            f"--program: how {target.board} is loaded is not known: load {bitstream} with the "
            "tool of your board, or give the arguments of openFPGALoader in the board file, "
            'for example loader = ["-c", "ft2232"]'
        )
    if find_tool("openFPGALoader") is not None:
        return ["openFPGALoader", *target.loader, bitstream]
    if target.family == "ecp5" and find_tool("ecpprog") is not None:
        return ["ecpprog", "-S", bitstream]
    return [require_tool("openFPGALoader")]  # which says how to install it


def load(target: Target, bitstream: Path, /) -> str:
    """Load a bitstream into the board and return what the tool printed.

    Raises
    ------
    BuildError, ToolError
        As `loading_command`, or if the tool fails.
    """
    tool, *arguments = loading_command(target, bitstream.name)
    return run_tool(tool, *arguments, cwd=bitstream.parent)
