# SPDX-License-Identifier: Apache-2.0
"""Corrects the net names in clock constraints after synthesis.

Amaranth constrains a clock under the name that it has in the deepest module. Synthesis may keep
another name of the same net, and nextpnr ignores a constraint on a net that does not exist; the
clock would then be routed without a timing goal. So every constraint is moved to a name that is
left after synthesis, and the build fails if there is none.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

from .report import BuildError

_CONSTRAINTS = {
    "ecp5": (".lpf", r'(FREQUENCY NET ")([^"]+)(" .*)'),
    "ice40": (".pcf", r"(set_frequency )(\S+)( .*)"),
}
"""Extension of the constraint file, and a pattern of its lines: before, name of, after the net."""


def rename_clocks(folder: Path, name: str, family: str, /) -> dict[str, str]:
    """Move clock constraints to net names that exist after synthesis.

    Parameters
    ----------
    folder : Path
        Folder of a build that has been synthesised.
    name : str
        Name of the top module and of the files.
    family : str
        ``"ecp5"`` or ``"ice40"``.

    Returns
    -------
    dict of str to str
        The new name of each net that was renamed.

    Raises
    ------
    BuildError
        If no net of a constrained clock is left.
    """
    suffix, pattern = _CONSTRAINTS[family]
    top = json.loads((folder / f"{name}.json").read_text())["modules"][name]
    names = {net: tuple(content["bits"]) for net, content in top["netnames"].items()}
    clocked = Counter(
        tuple(bits)
        for cell in top["cells"].values()
        for port, bits in cell["connections"].items()
        if port in ("CLK", "C")
    )
    path = folder / f"{name}{suffix}"
    renamed: dict[str, str] = {}
    lines = []
    for line in path.read_text().splitlines():
        match = re.fullmatch(pattern, line.strip())
        if match and match[2] not in names and match[2] not in top["ports"]:
            left = [net for net in names if _leaf(net) == _leaf(match[2]) and clocked[names[net]]]
            if not left:
                raise BuildError(
                    f"{path}: no net of the constrained clock {match[2]} is left after synthesis"
                )
            renamed[match[2]] = best = max(left, key=lambda net: clocked[names[net]])
            line = f"{match[1]}{best}{match[3]}"
        lines.append(line)
    path.write_text("\n".join(lines) + "\n")
    return renamed


def _leaf(net: str) -> str:
    return net.rsplit(".", 1)[-1]
