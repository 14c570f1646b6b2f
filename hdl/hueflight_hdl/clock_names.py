"""Names of clocks, once more after synthesis.

Amaranth constrains a clock under the name that it has in the deepest module; synthesis keeps
another of its names, and nextpnr passes over a constraint whose net is not there. A build whose
clocks are not constrained is routed for whatever comes, so here every constraint gets a name that
is left, and if there is none the build ends.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

from .build_report import BuildError

_CONSTRAINTS = {
    "ecp5": (".lpf", r'(FREQUENCY NET ")([^"]+)(" .*)'),
    "ice40": (".pcf", r"(set_frequency )(\S+)( .*)"),
}
"""The file, and its lines: what comes before the net, the net, and after it."""


def rename_clocks(folder: Path, name: str, family: str, /) -> dict[str, str]:
    """Give constraints the names that synthesis has left.

    Parameters
    ----------
    folder : Path
        Of a build that has been synthesised.
    name : str
        Of the top module, and of the files.
    family : str
        ``"ecp5"`` or ``"ice40"``.

    Returns
    -------
    dict of str to str
        New names by the old ones.

    Raises
    ------
    BuildError
        If a clock has no name left.
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
                raise BuildError(f"{path}: no clock is left that is called {match[2]}")
            renamed[match[2]] = best = max(left, key=lambda net: clocked[names[net]])
            line = f"{match[1]}{best}{match[3]}"
        lines.append(line)
    path.write_text("\n".join(lines) + "\n")
    return renamed


def _leaf(net: str) -> str:
    return net.rsplit(".", 1)[-1]
