# SPDX-License-Identifier: Apache-2.0
"""A board as a Python file: the BlackIce II by way of its TOML file."""

from pathlib import Path

from hueflight_hdl.boards.board_file import read_board_file
from hueflight_hdl.boards.from_file import board_target
from hueflight_hdl.boards.target import Options, Target, TargetError


def target(design: str, options: Options) -> Target:
    """Return the target of a design."""
    if design != "illuminator":
        raise TargetError(f"the {design} does not fit this board")
    return board_target(read_board_file(Path(__file__).with_name("blackice.toml")), options)
