# SPDX-License-Identifier: Apache-2.0
"""The slowest path of each clock, from nextpnr's report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class CriticalPath:
    """A path between two registers.

    Parameters
    ----------
    begins, ends : str
        Cells at its ends, as synthesis names them.
    logic_ns, routing_ns : float
        What cells and wires between them take, setup time included in the logic.
    levels : int
        Cells between the registers.
    """

    begins: str
    ends: str
    logic_ns: float
    routing_ns: float
    levels: int

    def describe(self) -> str:
        """Return a line for people."""
        return (
            f"{self.begins} → {self.ends}: {self.logic_ns + self.routing_ns:.2f} ns, of it "
            f"{self.routing_ns:.2f} ns in wires, {self.levels} cells between"
        )


def find_paths(
    content: list[dict[str, Any]], patterns: Mapping[str, str], /
) -> dict[str, CriticalPath]:
    """Return the slowest path within each clock domain.

    Parameters
    ----------
    content : list
        What a report of nextpnr has as ``critical_paths``.
    patterns : mapping of str to str
        Pattern of the name that the clock of each domain has there.

    Returns
    -------
    dict of str to CriticalPath
        By clock domain; a domain without a path between two of its registers is left out.
    """
    paths: dict[str, CriticalPath] = {}
    for domain, pattern in patterns.items():
        within = [
            _path(found["path"])
            for found in content
            if found["from"] == found["to"] and re.search(pattern, found["from"].partition(" ")[2])
        ]
        if within:
            paths[domain] = max(within, key=lambda path: path.logic_ns + path.routing_ns)
    return paths


def _path(segments: list[dict[str, Any]]) -> CriticalPath:
    wires = sum(segment["delay"] for segment in segments if segment["type"] == "routing")
    cells = sum(segment["delay"] for segment in segments if segment["type"] != "routing")
    return CriticalPath(
        begins=segments[0]["from"]["cell"],
        ends=segments[-1]["to"]["cell"],
        logic_ns=round(cells, 3),
        routing_ns=round(wires, 3),
        levels=sum(segment["type"] == "logic" for segment in segments),
    )
