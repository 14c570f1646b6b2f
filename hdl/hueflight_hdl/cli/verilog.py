# SPDX-License-Identifier: Apache-2.0
"""The subcommand ``hueflight-hdl verilog``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..boards.ecp5_illuminator import ecp5_config
from ..boards.settings import check_settings, set_illuminator
from ..boards.target import TargetError
from ..boards.targets import find_target
from ..build.core import write_core
from ..build.project import estimate, write_project
from .app import Progress, app
from .options import read_options


@app.command
def verilog(
    design: str,
    /,
    *,
    board: str | None = None,
    core: bool = False,
    folder: Path | None = None,
    pins: Path | None = None,
    lanes: int | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
    design_file: Path | None = None,
    count: bool = False,
) -> None:
    """Write a design as a Verilog project with constraints and build scripts, or without a board.

    Parameters
    ----------
    design
        Design to write: illuminator or camera.
    board
        Board to write the project for, for example ulx3s-85f, the paper's xem3010 or xem6310, or
        the path of a board file.
    core
        Write the illuminator without a board: one Verilog file without vendors' primitives, the
        list of its ports, and a testbench that checks itself in Icarus Verilog and Verilator.
    folder
        Output folder. The default is build/DESIGN-BOARD-project, or build/DESIGN-core.
    pins
        TOML file with the FPGA pins, required for boards whose wiring depends on the builder.
    lanes
        Number of codes per clock at the camera's sensor port: 1, 2, 4 or 8.
    set_
        A size or limit as NAME=VALUE, for example channels=4; may be repeated. An unknown name
        makes the error list all names.
    design_file
        TOML file of sizes and limits; --set has precedence.
    count
        Estimate the resources with yosys and print them.
    """
    progress = Progress()
    if core or board is None:
        options = read_options(words=set_, design_file=design_file)
        if not core or board is not None or design != "illuminator":
            raise TargetError("give either --board, or --core for the illuminator")
        if pins is not None or lanes is not None or count:
            raise TargetError("--core: --pins, --lanes and --count need a board; leave them out")
        progress(f"writing {design} without a board")
        config = set_illuminator(ecp5_config(), check_settings(design, options.settings))
        if config.reference_hz:
            raise TargetError(
                f"reference_hz = {config.reference_hz}: in plain Verilog the clocks are yours"
            )
        if config.fine_steps:
            raise TargetError("fine_delay = 1: in plain Verilog the outputs' registers are yours")
        for path in write_core(config, folder or Path("build") / f"{design}-core"):
            print(path)
        return
    target = find_target(
        design,
        board,
        read_options(pins=pins, lanes=lanes, words=set_, design_file=design_file),
    )
    where = folder or Path("build") / f"{design}-{target.board}-project"
    progress(f"writing {design} for {board}")
    for path in write_project(target, where):
        print(path)
    if count:
        progress("estimating resources with yosys")
        for kind, number in estimate(target, where).items():
            print(f"{kind}: {number}")
        print("estimated by yosys before placement and routing; the vendor's tools will differ")
