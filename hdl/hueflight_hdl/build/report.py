# SPDX-License-Identifier: Apache-2.0
"""Reports of builds: cells used, frequencies reached, seeds tried."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hueflight_protocol.errors import HueflightError

from .critical_path import CriticalPath, find_paths

REQUIRED_MARGIN = 0.10
"""Default timing margin: the fraction by which each clock must exceed its frequency."""
_CELLS = {
    "ecp5": {"LUT4": "TRELLIS_COMB", "flip-flop": "TRELLIS_FF", "block RAM": "DP16KD"},
    "ice40": {"logic cell": "ICESTORM_LC", "block RAM": "ICESTORM_RAM"},
}
"""Names of nextpnr's cells; an iCE40 logic cell is a LUT4 with a flip-flop."""


class BuildError(HueflightError):
    """A bitstream cannot be built, or a report of a build cannot be read."""


@dataclass(frozen=True)
class ClockResult:
    """Frequencies of a clock.

    Parameters
    ----------
    needed_mhz : float
        Frequency at which the design runs.
    reached_mhz : float
        Highest frequency according to placement and routing.
    """

    needed_mhz: float
    reached_mhz: float

    @property
    def margin(self) -> float:
        """Timing margin: reached / needed - 1."""
        return self.reached_mhz / self.needed_mhz - 1


@dataclass(frozen=True)
class BuildReport:
    """The result of a build.

    Parameters
    ----------
    design, board : str
        Names of the target.
    lanes : int or None
        Codes per clock at the camera's sensor port.
    bitstream : Path
        The file that is loaded into the FPGA.
    sha256 : str
        SHA-256 of the bitstream.
    used : dict of str to (int, int)
        Cells used and available, by kind of cell.
    clocks : dict of str to ClockResult
        Result of each clock domain.
    seed : int
        Seed with which the bitstream was routed.
    tried : dict of int to float
        Smallest timing margin for each seed that was tried.
    required : float
        Required timing margin.
    paths : dict of str to CriticalPath
        Slowest path of each clock domain.
    """

    design: str
    board: str
    lanes: int | None
    bitstream: Path
    sha256: str
    used: dict[str, tuple[int, int]]
    clocks: dict[str, ClockResult]
    seed: int
    tried: dict[int, float]
    required: float
    paths: dict[str, CriticalPath] = field(default_factory=dict)

    @property
    def margin(self) -> float:
        """The smallest timing margin of all clocks."""
        return min(clock.margin for clock in self.clocks.values())

    @property
    def reached(self) -> bool:
        """Whether every clock meets the required timing margin."""
        return self.margin >= self.required

    def to_json(self) -> str:
        """Return the report as JSON.

        The bitstream appears without its folder, so that reports of equal builds are equal.
        """
        content = asdict(self)
        content["bitstream"] = self.bitstream.name
        for name, clock in self.clocks.items():
            content["clocks"][name]["margin"] = round(clock.margin, 4)
        content["reached"] = self.reached
        return json.dumps(content, indent=2) + "\n"


def read_clocks(path: Path, needed: Mapping[str, float], /) -> dict[str, ClockResult]:
    """Read the frequency that each clock reached from nextpnr's report.

    Parameters
    ----------
    path : Path
        The report, a JSON file.
    needed : mapping of str to float
        Required frequency of each clock domain in MHz.

    Returns
    -------
    dict of str to ClockResult
        Result of each clock domain.

    Raises
    ------
    BuildError
        If a clock is not in the report.
    """
    fmax = _load(path)["fmax"]
    return {domain: ClockResult(mhz, _reached(fmax, domain)) for domain, mhz in needed.items()}


def read_cells(path: Path, family: str, /) -> dict[str, tuple[int, int]]:
    """Read the cells used and available, by kind, from nextpnr's report."""
    found = _load(path)["utilization"]
    return {
        kind: (found[cell]["used"], found[cell]["available"])
        for kind, cell in _CELLS[family].items()
    }


def read_paths(path: Path, domains: Iterable[str], /) -> dict[str, CriticalPath]:
    """Read the slowest path of each clock domain from nextpnr's report."""
    patterns = {domain: _clock_pattern(domain) for domain in domains}
    return find_paths(_load(path).get("critical_paths", []), patterns)


def digest(path: Path, /) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _load(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise BuildError(f"{path}: cannot be read as a report of nextpnr ({error})") from error


def _clock_name(domain: str) -> str:
    """Return the name that Amaranth gives to a domain's clock: that of `sync` is just ``clk``."""
    return "clk" if domain == "sync" else f"{domain}_clk"


def _clock_pattern(domain: str) -> str:
    """Return the pattern of net names that a domain's clock has after placement."""
    return rf"(^|[.$]){_clock_name(domain)}(_\$glb_clk|\$\d+|\$glb\w*)?$"


def _reached(fmax: Mapping[str, Mapping[str, float]], domain: str) -> float:
    """Find a domain's clock among the nets; the slowest counts."""
    pattern = _clock_pattern(domain)
    found = [result["achieved"] for net, result in fmax.items() if re.search(pattern, net)]
    if not found:
        raise BuildError(
            f"no clock {_clock_name(domain)!r} in nextpnr's report, which has {', '.join(fmax)}"
        )
    return min(found)
