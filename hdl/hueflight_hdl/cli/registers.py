# SPDX-License-Identifier: Apache-2.0
"""The subcommand ``hueflight-hdl registers``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hueflight_protocol.register_formats import FORMATS
from hueflight_protocol.registers import RegisterMap

from ..boards.ecp5_camera import camera_config
from ..boards.ecp5_illuminator import ecp5_config
from ..boards.settings import BY_DESIGN, check_settings, set_illuminator
from ..boards.target import Options, TargetError
from ..boards.targets import find_target
from .app import app
from .options import read_options


@app.command
def registers(
    design: str,
    /,
    *,
    board: str | None = None,
    format_: Annotated[str, Parameter(name="--format")] = "json",
    out: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
    pins: Path | None = None,
    design_file: Path | None = None,
) -> None:
    """Write the register map of a design for other programs.

    Parameters
    ----------
    design
        Design whose registers are written: illuminator or camera.
    board
        Board of the build, for example hx8k, or the path of a board file: the clock and the ticks
        per clock depend on it. The default is an ECP5 with a tick of 1.25 ns.
    format_
        Format: json, svd (CMSIS-SVD, byte addresses) or c (a header of macros).
    out
        File to write. The default is standard output.
    set_
        A size as NAME=VALUE, for example channels=4; may be repeated.
    pins
        TOML file with the FPGA pins, required for boards whose wiring depends on the builder.
    design_file
        TOML file of sizes, for example the design.toml of a build; --set has precedence.
    """
    if format_ not in FORMATS:
        raise TargetError(f"--format {format_}: must be one of {', '.join(FORMATS)}")
    options = read_options(pins=pins, words=set_, design_file=design_file)
    text = FORMATS[format_](_registers(design, board, options))
    if out is None:
        print(text, end="")
    else:
        out.write_text(text)


def _registers(design: str, board: str | None, options: Options) -> RegisterMap:
    if board is not None:
        registers = find_target(design, board, options).registers
        if registers is None:
            raise TargetError(f"--board {board}: its target has no register map")
        return registers
    if options.pins is not None:
        raise TargetError(f"--pins {options.pins}: give --board too, or leave it out")
    if design not in BY_DESIGN:
        raise TargetError(f"there is no design {design!r}: choose one of {', '.join(BY_DESIGN)}")
    values = check_settings(design, options.settings)
    if design == "camera":
        return camera_config(Options(settings=values)).registers()
    return set_illuminator(ecp5_config(), values).registers()
