"""How a build came out: cells used, what each clock reached, seeds tried."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from hueflight_protocol.errors import HueflightError

REQUIRED_MARGIN = 0.10
"""A clock must be able to run faster than it does by so much of its frequency."""
_CELLS = {
    "ecp5": {"LUT4": "TRELLIS_COMB", "flip-flop": "TRELLIS_FF", "block RAM": "DP16KD"},
    "ice40": {"logic cell": "ICESTORM_LC", "block RAM": "ICESTORM_RAM"},
}
"""Names of nextpnr's cells; an iCE40 logic cell is a LUT4 with a flip-flop."""


class BuildError(HueflightError):
    """A build that can't be made or read."""


@dataclass(frozen=True)
class ClockResult:
    """What a clock reached.

    Parameters
    ----------
    needed_mhz, reached_mhz : float
        What the design runs at; what place and route found possible.
    """

    needed_mhz: float
    reached_mhz: float

    @property
    def margin(self) -> float:
        """Reached over needed, less 1."""
        return self.reached_mhz / self.needed_mhz - 1


@dataclass(frozen=True)
class BuildReport:
    """How a build came out.

    Parameters
    ----------
    design, board : str
    lanes : int or None
        Codes per clock at the camera's sensor port.
    bitstream : Path
    sha256 : str
        Of the bitstream.
    used : dict
        Cells used and available, by kind.
    clocks : dict
        By domain.
    seed : int
        That the bitstream was routed with.
    tried : dict
        Smallest margin, by seed.
    required : float
        Margin asked for.
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

    @property
    def margin(self) -> float:
        """The smallest of all clocks."""
        return min(clock.margin for clock in self.clocks.values())

    @property
    def reached(self) -> bool:
        """Whether every clock has the margin asked for."""
        return self.margin >= self.required

    def to_json(self) -> str:
        """Return the report as JSON; the bitstream by its name, so that equal builds agree."""
        content = asdict(self)
        content["bitstream"] = self.bitstream.name
        for name, clock in self.clocks.items():
            content["clocks"][name]["margin"] = round(clock.margin, 4)
        content["reached"] = self.reached
        return json.dumps(content, indent=2) + "\n"


def read_clocks(path: Path, needed: Mapping[str, float], /) -> dict[str, ClockResult]:
    """Return what each domain's clock reached, from nextpnr's report.

    Raises
    ------
    BuildError
        If a clock is not in the report.
    """
    fmax = _load(path)["fmax"]
    return {domain: ClockResult(mhz, _reached(fmax, domain)) for domain, mhz in needed.items()}


def read_cells(path: Path, family: str, /) -> dict[str, tuple[int, int]]:
    """Return cells used and available by kind, from nextpnr's report."""
    found = _load(path)["utilization"]
    return {
        kind: (found[cell]["used"], found[cell]["available"])
        for kind, cell in _CELLS[family].items()
    }


def digest(path: Path, /) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _load(path: Path) -> dict[str, dict]:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise BuildError(f"{path}: no report of place and route ({error})") from error


def _reached(fmax: Mapping[str, Mapping[str, float]], domain: str) -> float:
    """Find a domain's clock among the nets: Amaranth calls that of `sync` just ``clk``."""
    name = "clk" if domain == "sync" else f"{domain}_clk"
    found = [
        result["achieved"]
        for net, result in fmax.items()
        if re.search(rf"(^|[.$]){name}(_\$glb_clk|\$\d+|\$glb\w*)?$", net)
    ]
    if not found:
        raise BuildError(f"no clock {name!r} in the report of place and route: {', '.join(fmax)}")
    return min(found)
