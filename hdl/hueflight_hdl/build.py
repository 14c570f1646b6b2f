"""Bitstreams: prepare a target, synthesise once, route with seeds until the clocks have room."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from .boards.target import Target
from .build_report import (
    REQUIRED_MARGIN,
    BuildError,
    BuildReport,
    ClockResult,
    digest,
    read_cells,
    read_clocks,
)
from .clock_names import rename_clocks
from .toolchain import TOOLS, require_tool, run_tool

NAME = "top"
SEEDS = range(1, 9)
"""Seeds of place and route that are tried in turn."""
_PACKERS = {
    "ecp5": ("nextpnr-ecp5", "ecppack", ".config", ".bit"),
    "ice40": ("nextpnr-ice40", "icepack", ".asc", ".bin"),
}
"""Router, packer, and the names of what they write."""
_ECP5_ROUTE = " --placer-heap-timingweight 30 --tmg-ripup"
"""These designs fill little of the device, and the usual weight of 10 scatters them over it."""

Progress = Callable[[str], None]


def build(
    target: Target,
    folder: Path,
    /,
    *,
    seeds: Sequence[int] = SEEDS,
    margin: float = REQUIRED_MARGIN,
    progress: Progress = lambda said: None,
) -> BuildReport:
    """Build a target's bitstream.

    Parameters
    ----------
    target : Target
    folder : Path
        Where everything is written; made if needed.
    seeds : sequence of int
        Of place and route. The first that gives every clock its margin is taken, or else the
        best. The same sources, tools and seeds give the same bits.
    margin : float
        By which clocks must be able to run faster than they do.
    progress : callable
        Is told what begins.

    Returns
    -------
    BuildReport
        Which says whether the margin was reached; it is also written as ``report.json``.

    Raises
    ------
    ToolError
        If a tool is not there or fails.
    BuildError
        If the board is not built with open tools, or there is no seed to try.
    """
    if target.family not in _PACKERS:
        raise BuildError(
            f"{target.board} is built with Xilinx ISE: write its project with "
            f"`hueflight-hdl verilog {target.design} --board {target.board}`"
        )
    if not seeds:
        raise BuildError("no seed to route with: give one or more")
    router, packer, routed, suffix = _PACKERS[target.family]
    for tool in ("yosys", router, packer):
        require_tool(tool)
    synthesise, route, pack = prepare(target, folder)
    progress(f"synthesis of {target.design} for {target.board}")
    run_tool(*synthesise, cwd=folder)
    rename_clocks(folder, NAME, target.family)
    tried: dict[int, dict[str, ClockResult]] = {}
    best = seeds[0]
    for seed in seeds:
        progress(f"place and route, seed {seed}")
        run_tool(*route, "--seed", str(seed), cwd=folder)
        tried[seed] = read_clocks(folder / "nextpnr.json", target.clocks_mhz)
        progress(f"seed {seed}: " + said_clocks(tried[seed]))
        if seed == seeds[0] or least(tried[seed]) > least(tried[best]):
            best = seed
            for name in (f"{NAME}{routed}", "nextpnr.json"):
                shutil.copyfile(folder / name, folder / f"best-{name}")
        if least(tried[seed]) >= margin:
            break
    for name in (f"{NAME}{routed}", "nextpnr.json"):
        (folder / f"best-{name}").replace(folder / name)
    progress("packing")
    run_tool(*pack, cwd=folder)
    bitstream = folder / f"{NAME}{suffix}"
    report = BuildReport(
        design=target.design,
        board=target.board,
        lanes=target.lanes,
        bitstream=bitstream,
        sha256=digest(bitstream),
        used=read_cells(folder / "nextpnr.json", target.family),
        clocks=tried[best],
        seed=best,
        tried={seed: round(least(clocks), 4) for seed, clocks in tried.items()},
        required=margin,
    )
    (folder / "report.json").write_text(report.to_json())
    return report


def prepare(target: Target, folder: Path, /) -> list[list[str]]:
    """Write a target's sources, constraints and scripts; return the tools to run, in order."""
    folder.mkdir(parents=True, exist_ok=True)
    options = {
        "nextpnr_opts": "--report nextpnr.json --timing-allow-fail"
        + (_ECP5_ROUTE if target.family == "ecp5" else ""),
        **({"ecppack_opts": "--compress"} if target.family == "ecp5" else {}),
        **target.options,
    }
    plan = target.platform().prepare(target.top(), NAME, emit_src=False, **options)
    plan.extract(str(folder))
    return _commands(folder / f"build_{NAME}.sh") if target.family in _PACKERS else []


def least(clocks: dict[str, ClockResult], /) -> float:
    """Return the smallest margin."""
    return min(clock.margin for clock in clocks.values())


def said_clocks(clocks: dict[str, ClockResult], /) -> str:
    """Return what each clock reached, in words."""
    return ", ".join(
        f"{name} {c.reached_mhz:.1f} MHz of {c.needed_mhz:g} ({c.margin:+.1%})"
        for name, c in clocks.items()
    )


def _commands(script: Path) -> list[list[str]]:
    """Return the tools that Amaranth's build script runs, with their arguments."""
    tools = {variable: tool for tool, (variable, _) in TOOLS.items()}
    lines = script.read_text().splitlines()
    matches = [re.match(r'"\$(\w+)" (.*)', line) for line in lines]
    return [[tools[match[1]], *match[2].split()] for match in matches if match]
