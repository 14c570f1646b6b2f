# SPDX-License-Identifier: Apache-2.0
"""The subcommand ``hueflight-hdl build``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from ..boards.targets import find_target
from ..build.build import build as build_target
from ..build.program import load, loading_command
from ..build.report import REQUIRED_MARGIN, BuildError, BuildReport
from .app import EXIT_SHORT, Progress, app, errors
from .options import read_options


@app.command
def build(
    design: str,
    /,
    *,
    board: str,
    folder: Path | None = None,
    seed: int = 1,
    seeds: int = 8,
    accept_margin: Annotated[float, Parameter(name="--accept-margin")] = 100 * REQUIRED_MARGIN,
    lanes: int | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
    design_file: Path | None = None,
    program: bool = False,
    json: bool = False,
) -> None:
    """Build a bitstream with the open tools and report its timing margins and cell counts.

    The exit code is 2 if a clock misses the required timing margin. The bitstream and its report
    are written in that case too.

    Parameters
    ----------
    design
        Design to build: illuminator or camera.
    board
        Board to build for, for example ulx3s-85f, or the path of a board file. An unknown name
        makes the error list all boards.
    folder
        Output folder. The default is build/DESIGN-BOARD.
    seed
        First seed of placement and routing.
    seeds
        Number of seeds to try, in order, until every clock has the required timing margin.
    accept_margin
        Required timing margin in percent: how much faster than its frequency each clock can run.
    lanes
        Number of codes per clock at the camera's sensor port: 1, 2, 4 or 8.
    set_
        A size or limit as NAME=VALUE, for example channels=4; may be repeated. An unknown name
        makes the error list all names.
    design_file
        TOML file of sizes and limits; --set has precedence. Each build writes one, design.toml.
    program
        Load the bitstream into the board's FPGA, until power-off, if every clock has its margin.
        Disconnect LED drivers first.
    json
        Print the report as JSON instead of a table.
    """
    if seeds < 1:
        raise BuildError(f"--seeds {seeds}: must be 1 or more")
    if accept_margin < 0:
        raise BuildError(
            f"--accept-margin {accept_margin:g}: must be 0 or more; with a negative margin "
            "the design would not work"
        )
    target = find_target(
        design, board, read_options(lanes=lanes, words=set_, design_file=design_file)
    )
    if program:
        loading_command(target, "top.bit")  # whether it can be loaded, before minutes of building
    report = build_target(
        target,
        folder or Path("build") / f"{design}-{target.board}",
        seeds=range(seed, seed + seeds),
        margin=accept_margin / 100,
        progress=Progress(),
    )
    if json:
        print(report.to_json(), end="")
    else:
        show(report)
    if not report.reached:
        errors.print(
            f"timing margin missed: the smallest margin is {report.margin:+.1%} after "
            f"{len(report.tried)} seeds, {report.required:.0%} is required; try other seeds with "
            "--seed and --seeds, or accept less with --accept-margin"
        )
        raise SystemExit(EXIT_SHORT)
    if program:
        Progress()(f"loading {report.bitstream.name} into {target.board}")
        errors.print(load(target, report.bitstream))
    if report.required < REQUIRED_MARGIN:
        errors.print(
            f"note: a timing margin of {report.required:.1%} was accepted instead of the usual "
            f"{REQUIRED_MARGIN:.0%}; the smallest margin is {report.margin:+.1%}"
        )


def show(report: BuildReport) -> None:
    """Print a report as a table."""
    table = Table(title=f"{report.design} on {report.board}", title_justify="left", box=None)
    for name in ("", "used / reached", "available / needed", "margin"):
        table.add_column(name, justify="right" if name else "left")
    for kind, (used, available) in report.used.items():
        table.add_row(f"{kind}s", f"{used}", f"{available}", f"{1 - used / available:.0%} free")
    for name, clock in report.clocks.items():
        reached, needed = f"{clock.reached_mhz:.1f} MHz", f"{clock.needed_mhz:g} MHz"
        table.add_row(f"clock {name}", reached, needed, f"{clock.margin:+.1%}")
    console = Console(highlight=False)
    console.print(table)
    for name, path in report.paths.items():
        console.print(f"slowest path of {name}: {path.describe()}", soft_wrap=True)
    tried = ", ".join(f"{seed}: {margin:+.1%}" for seed, margin in report.tried.items())
    console.print(f"seed {report.seed} (tried {tried})")
    console.print(f"{report.bitstream} sha256 {report.sha256}", soft_wrap=True)
