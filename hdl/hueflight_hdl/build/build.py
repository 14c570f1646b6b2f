# SPDX-License-Identifier: Apache-2.0
"""Builds bitstreams: synthesis, then placement and routing until the timing margin is met."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from ..boards.settings import write_design_file
from ..boards.target import Target
from ..toolchain import TOOLS, ToolError, offer_yosys, require_tool, run_tool
from .clock_constraints import rename_clocks
from .report import (
    REQUIRED_MARGIN,
    BuildError,
    BuildReport,
    ClockResult,
    digest,
    read_cells,
    read_clocks,
    read_paths,
)

NAME = "top"
SEEDS = range(1, 9)
"""Seeds of placement and routing, tried in this order."""
_PACKERS = {
    "ecp5": ("nextpnr-ecp5", "ecppack", ".config", ".bit"),
    "ice40": ("nextpnr-ice40", "icepack", ".asc", ".bin"),
}
"""Router, packer, and the file extensions of what they write."""
_VENDOR_TOOLS = {"xc3s": "ISE", "xc6s": "ISE", "xc7": "Vivado"}
_NO_ROOM = re.compile(
    r"no BELs remaining|Failed to expand region|[Uu]nable to (place|find)|ran out of|not enough"
)
"""What routers say of a design that is too large for its device."""
_EDGES = "Unable to route edge clock source"
"""What the router says of geared pins on both edges of the device, which have their own clocks."""
_SIZES = {
    "illuminator": ("channels", "pulses", "steps"),
    "camera": ("lanes", "code_bits", "run", "banks", "buffer_words", "sums", "sum_bits"),
}
"""Settings that decide how large a design is."""
_ECP5_ROUTE = " --placer-heap-timingweight 30 --tmg-ripup"
"""These designs fill little of the device, and the default weight of 10 spreads them over it."""

_ONLY_TOP = "delete =$paramod* =A:blackbox %i"
"""A yosys command that removes declarations of primitives from the netlist.

Among them is one for each content of a memory, with a name made of that content. The router numbers
names in the order in which it meets them, so these would let constants such as the hash of the
sources change the placement.
"""

Progress = Callable[[str], None]


def build(
    target: Target,
    folder: Path,
    /,
    *,
    seeds: Sequence[int] = SEEDS,
    margin: float = REQUIRED_MARGIN,
    progress: Progress = lambda line: None,
) -> BuildReport:
    """Build a target's bitstream.

    Parameters
    ----------
    target : Target
        Design and board.
    folder : Path
        Output folder; it is created if needed.
    seeds : sequence of int
        Seeds of placement and routing. The first one that meets the margin for every clock is
        taken, otherwise the best one. The same sources, tools and seeds give the same bits.
    margin : float
        Required timing margin, as a fraction of each clock's frequency.
    progress : callable
        Called with a line of text when a step begins.

    Returns
    -------
    BuildReport
        Cells, clocks and whether the margin was met; also written as ``report.json``.

    Raises
    ------
    ToolError
        If a tool is not installed or fails.
    BuildError
        If the board cannot be built with open tools, or `seeds` is empty.
    """
    if target.family not in _PACKERS:
        raise BuildError(
            f"{target.board} needs Xilinx {_VENDOR_TOOLS[target.family]}: write a project for it "
            f"with `hueflight-hdl verilog {target.design} --board {target.board}`"
        )
    if not seeds:
        raise BuildError("seeds is empty: give at least one seed for placement and routing")
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
        progress(f"placement and routing, seed {seed}")
        _route(target, [*route, "--seed", str(seed)], folder)
        tried[seed] = read_clocks(folder / "nextpnr.json", target.clocks_mhz)
        progress(f"seed {seed}: " + describe_clocks(tried[seed]))
        if seed == seeds[0] or smallest_margin(tried[seed]) > smallest_margin(tried[best]):
            best = seed
            for name in (f"{NAME}{routed}", "nextpnr.json"):
                shutil.copyfile(folder / name, folder / f"best-{name}")
        if smallest_margin(tried[seed]) >= margin:
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
        tried={seed: round(smallest_margin(clocks), 4) for seed, clocks in tried.items()},
        required=margin,
        paths=read_paths(folder / "nextpnr.json", target.clocks_mhz),
    )
    (folder / "report.json").write_text(report.to_json())
    return report


def prepare(target: Target, folder: Path, /) -> list[list[str]]:
    """Write a target's sources, constraints and scripts.

    Parameters
    ----------
    target : Target
        Design and board.
    folder : Path
        Output folder; it is created if needed.

    Returns
    -------
    list of list of str
        Tools to run, in order, with their arguments; empty for boards that need vendor tools.
    """
    folder.mkdir(parents=True, exist_ok=True)
    offer_yosys()  # some families take Verilog
    route = ["--report nextpnr.json --timing-allow-fail", target.options.get("nextpnr_opts", "")]
    options = {
        **({"ecppack_opts": "--compress"} if target.family == "ecp5" else {}),
        **target.options,
        "nextpnr_opts": " ".join(filter(None, route))
        + (_ECP5_ROUTE if target.family == "ecp5" else ""),
    }
    options["script_after_synth"] = "; ".join(
        filter(None, (options.get("script_after_synth"), _ONLY_TOP))
    )
    if target.settings:
        write_design_file(folder / "design.toml", target.design, target.settings)
    plan = target.platform().prepare(target.top(), NAME, emit_src=False, **options)
    plan.extract(str(folder))
    return _commands(folder / f"build_{NAME}.sh") if target.family in _PACKERS else []


def _route(target: Target, command: list[str], folder: Path) -> None:
    """Place and route; say what to do if the device is too small or its edges are mixed."""
    try:
        run_tool(*command, cwd=folder)
    except ToolError as error:
        if _EDGES in str(error):
            raise BuildError(
                f"{target.board}: led_pulse, trigger and trigger_out must all be on the left edge "
                f"of the device, or all on the right one: each edge has its own clock\n{error}"
            ) from error
        if not _NO_ROOM.search(str(error)):
            raise
        chosen = ", ".join(f"{name} = {target.settings[name]}" for name in _SIZES[target.design])
        raise BuildError(
            f"the {target.design} does not fit {target.board} with {chosen}: choose less with "
            f"--set NAME=VALUE\n{error}"
        ) from error


def smallest_margin(clocks: dict[str, ClockResult], /) -> float:
    """Return the smallest timing margin of all clocks."""
    return min(clock.margin for clock in clocks.values())


def describe_clocks(clocks: dict[str, ClockResult], /) -> str:
    """Return a line that says what frequency each clock reached."""
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
