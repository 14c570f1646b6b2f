"""A design on a board: what can be built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from amaranth.build import Platform
from amaranth.hdl import Elaboratable


@dataclass(frozen=True)
class Target:
    """One design on one board.

    Parameters
    ----------
    design, board : str
        Names on the command line.
    platform : callable
        Makes the board's platform, pins of the design included.
    top : callable
        Makes the design, clocks and pins included, for that platform.
    clocks_mhz : mapping of str to float
        Clock domain and the frequency that it must reach.
    family : str
        ``"ecp5"``, ``"ice40"``, or ``"ise"``, for which a project is written.
    options : mapping of str to str
        Overrides of the platform's build, as amaranth takes them.
    """

    design: str
    board: str
    platform: Callable[[], Platform]
    top: Callable[[], Elaboratable]
    clocks_mhz: Mapping[str, float]
    family: str
    options: Mapping[str, str] = field(default_factory=dict)
