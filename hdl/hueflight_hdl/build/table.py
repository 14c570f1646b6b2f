# SPDX-License-Identifier: Apache-2.0
"""The page of bitstreams, from the reports that builds leave behind.

``python -m hueflight_hdl.build.table build > docs/bitstreams.md`` takes every ``report.json`` (of
`hueflight-hdl build`) and ``counts.json`` (of `hueflight-hdl verilog --count`) below a folder.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from .report import REQUIRED_MARGIN, BuildError

COMMAND = "python -m hueflight_hdl.build.table build > docs/bitstreams.md"
_HEAD = f"""# Bitstreams

The resources and clock frequencies of each design, from real builds with the open toolchain
(yosys, nextpnr, Project Trellis and Project IceStorm). Every clock must be able to run at least
{REQUIRED_MARGIN:.0%} faster than its frequency; otherwise the build ends with exit code 2
and a message. The same sources, tools and seed give the same bits. What identifies a build
(version, hash of the sources, serial number) is the content of a block memory, which does not
affect placement: a change of these alone leaves cells and margins as they are.

This page is generated from the reports of those builds:

```sh
{COMMAND}
```
"""
_COUNTS = """## After synthesis

Cells counted by yosys before packing and placement, with `hueflight-hdl verilog DESIGN --board
BOARD --count`. For the boards of the paper, whose FPGAs only the vendor's ISE can place and route,
the count is an **estimate**: the vendor's tools pack differently, and the host interface is not
counted. Lanes are the codes that the sensor port takes in each clock.
"""

_LINKS = """
## Tests of the links

| link | board | tested |
|---|---|---|
| serial line | illuminator, all; camera on ULX3S (control) | bit for bit in simulation |
| USB 2 at high speed (LUNA) | camera on ECPIX-5 | in simulation against a model of a host on the \
transceiver's interface (UTMI): chirp, enumeration, control, and a stream on a bus that damages \
packets and loses acknowledgements; not on hardware |
| FT601 (USB 3) | camera on ULX3S, packets | in simulation against a model of the chip's write \
cycle; not on hardware. `TXE_N` goes straight to the enable of the output registers, which at \
100 MHz asks for short wires |
| Opal Kelly (USB 3) | camera on XEM6310 | the part in front of the vendor's modules in \
simulation; **not tested on hardware** |

No design has been loaded into a board by the project's own tests.
""".replace("\\\n", "")


def page(reports: Iterable[dict[str, Any]], counts: Iterable[dict[str, Any]], /) -> str:
    """Return the page in Markdown.

    Parameters
    ----------
    reports : iterable of dict
        As `BuildReport.to_json` has them.
    counts : iterable of dict
        As `project.estimate` writes them.
    """
    lines = [_HEAD, "## Placed and routed", ""]
    rows = [
        [
            _name(report),
            ", ".join(f"{used} {kind}s" for kind, (used, _) in report["used"].items()),
            ", ".join(
                f"{name} {clock['reached_mhz']:.1f} of {clock['needed_mhz']:g} MHz "
                f"({clock['margin']:+.1%})"
                for name, clock in report["clocks"].items()
            ),
            "yes" if report["reached"] else "**no**",
            f"{report['seed']} ({len(report['tried'])})",
        ]
        for report in sorted(reports, key=_order)
    ]
    lines += _table(["design, board", "cells", "clocks", "margin", "seed (tried)"], rows)
    counted = sorted(counts, key=_order)
    if counted:
        kinds = list(dict.fromkeys(kind for count in counted for kind in count["cells"]))
        rows = [
            [_name(count), *(str(count["cells"].get(kind, "–")) for kind in kinds)]
            for count in counted
        ]
        lines += ["", _COUNTS, *_table(["design, board", *(f"{kind}s" for kind in kinds)], rows)]
    return "\n".join(lines) + "\n" + _LINKS


def _name(content: dict[str, Any]) -> str:
    count = content.get("lanes")
    lanes = f", {count} lane{'s' if count > 1 else ''}" if count else ""
    sensor = ", sensor on pins" if "sensor" in content.get("clocks", {}) else ""
    return f"{content['design']}, {content['board']}{lanes}{sensor}"


def _order(content: dict[str, Any]) -> tuple[str, str, int]:
    return content["design"], content["board"], content.get("lanes") or 0


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows)]


def main(folders: Sequence[str]) -> None:
    """Print the page of what lies below folders.

    Raises
    ------
    BuildError
        If there is no report.
    """
    found = {
        name: [
            json.loads(path.read_text())
            for folder in folders
            for path in sorted(Path(folder).rglob(name))
        ]
        for name in ("report.json", "counts.json")
    }
    if not any(found.values()):
        raise BuildError(f"no report.json below {', '.join(folders)}: build something first")
    print(page(found["report.json"], found["counts.json"]), end="")


if __name__ == "__main__":
    main(sys.argv[1:] or ["build"])
