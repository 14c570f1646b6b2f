# SPDX-License-Identifier: Apache-2.0
"""Completes projects for open tools: constraints that exist, and scripts that fail with timing."""

from __future__ import annotations

import re
from pathlib import Path

from ..boards.target import Target
from ..toolchain import run_tool
from .clock_constraints import rename_clocks
from .report import REQUIRED_MARGIN

CHECK = "check_timing.py"
_CHECK_SOURCE = '''\
"""Ends with an error unless every clock has its timing margin, by nextpnr's report."""

import json
import re
import sys

NEEDED_MHZ = {needed!r}
MARGIN = {margin!r}

fmax = json.load(open("nextpnr.json"))["fmax"]
short = False
for domain, needed in NEEDED_MHZ.items():
    name = "clk" if domain == "sync" else domain + "_clk"
    pattern = r"(^|[.$])" + name + r"(_\\$glb_clk|\\$\\d+|\\$glb\\w*)?$"
    found = [clock["achieved"] for net, clock in fmax.items() if re.search(pattern, net)]
    reached = min(found, default=0.0)
    enough = reached >= needed * (1 + MARGIN)
    short = short or not enough
    print(f"{{domain}}: {{reached:.1f}} MHz of {{needed:g}}", "" if enough else "TIMING IS NOT MET")
sys.exit(1 if short else 0)
'''


def complete_project(target: Target, commands: list[list[str]], folder: Path, name: str, /) -> None:
    """Make a written project independent of this package.

    Synthesis renames nets, and routers ignore constraints on names that do not exist. So the
    design is synthesised once, and the constraints get the names that are left. The scripts end
    with an error if a clock misses its margin.

    Parameters
    ----------
    target : Target
        Design and board.
    commands : list of list of str
        Tools that the project's script runs, synthesis first.
    folder : Path
        Folder of the project.
    name : str
        Name of the top module and of the files.
    """
    run_tool(*commands[0], cwd=folder)
    rename_clocks(folder, name, target.family)
    source = _CHECK_SOURCE.format(needed=dict(target.clocks_mhz), margin=REQUIRED_MARGIN)
    (folder / CHECK).write_text(source)
    for suffix, line in ((".sh", f"python3 {CHECK}"), (".bat", f"python {CHECK} || exit /b")):
        script = folder / f"build_{name}{suffix}"
        lines = script.read_text().splitlines()
        at = next(i for i, text in enumerate(lines) if re.match(r'"[$%].*NEXTPNR', text))
        script.write_text("\n".join([*lines[: at + 1], line, *lines[at + 1 :]]) + "\n")
