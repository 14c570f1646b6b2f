"""hueflight-hdl build"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from ..boards.target import Options
from ..boards.targets import find_target
from ..build import build as build_target
from ..build_report import REQUIRED_MARGIN, BuildError, BuildReport
from .app import EXIT_SHORT, Said, app, errors


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
    json: bool = False,
) -> None:
    """Build a bitstream with the open toolchain and report how well it came out.

    The exit code is 2 if a clock has less than the margin asked for; the bitstream and its report
    are there all the same.

    Parameters
    ----------
    design
        illuminator or camera.
    board
        For example ulx3s-85f; an unknown one lists them all.
    folder
        Where everything is written; by default build/DESIGN-BOARD.
    seed
        First seed of place and route.
    seeds
        How many are tried, one after the other, until every clock has its margin.
    accept_margin
        Percent by which each clock must be able to run faster than it does.
    lanes
        Codes per clock at the camera's sensor port: 1, 2, 4 or 8.
    json
        Print the report as JSON.
    """
    if seeds < 1:
        raise BuildError(f"--seeds {seeds}: must be 1 or more")
    if accept_margin < 0:
        raise BuildError(
            f"--accept-margin {accept_margin:g}: below 0 the design would not work; 0 or more"
        )
    target = find_target(design, board, Options(lanes=lanes))
    report = build_target(
        target,
        folder or Path("build") / f"{design}-{board}",
        seeds=range(seed, seed + seeds),
        margin=accept_margin / 100,
        progress=Said(),
    )
    if json:
        print(report.to_json(), end="")
    else:
        show(report)
    if not report.reached:
        errors.print(
            f"short of margin: {report.margin:+.1%} where {report.required:.0%} was asked for, "
            f"after {len(report.tried)} seeds; --seed, --seeds and --accept-margin change that"
        )
        raise SystemExit(EXIT_SHORT)
    if report.required < REQUIRED_MARGIN:
        errors.print(
            f"note: {report.required:.1%} was accepted where {REQUIRED_MARGIN:.0%} is the rule; "
            f"the least margin is {report.margin:+.1%}"
        )


def show(report: BuildReport) -> None:
    """Print a report for people."""
    table = Table(title=f"{report.design} on {report.board}", title_justify="left", box=None)
    for name in ("", "has", "of", "margin"):
        table.add_column(name, justify="right" if name else "left")
    for kind, (used, available) in report.used.items():
        table.add_row(f"{kind}s", f"{used}", f"{available}", f"{1 - used / available:.0%} free")
    for name, clock in report.clocks.items():
        reached, needed = f"{clock.reached_mhz:.1f} MHz", f"{clock.needed_mhz:g} MHz"
        table.add_row(f"clock {name}", reached, needed, f"{clock.margin:+.1%}")
    console = Console(highlight=False)
    console.print(table)
    tried = ", ".join(f"{seed}: {margin:+.1%}" for seed, margin in report.tried.items())
    console.print(f"seed {report.seed} (tried {tried})")
    console.print(f"{report.bitstream} sha256 {report.sha256}", soft_wrap=True)
