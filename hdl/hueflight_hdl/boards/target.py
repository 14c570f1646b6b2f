"""A design on a board: what can be built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from amaranth.build import Platform
from amaranth.hdl import Elaboratable

from hueflight_protocol.errors import HueflightError


class TargetError(HueflightError):
    """A design that can't be built for a board as asked."""


@dataclass(frozen=True)
class Options:
    """What a builder may choose.

    Parameters
    ----------
    pins : Path, optional
        TOML file of pins, for boards whose pins are not known here.
    lanes : int, optional
        Codes per clock at the camera's sensor port.
    """

    pins: Path | None = None
    lanes: int | None = None


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
        ``"ecp5"`` or ``"ice40"``, built with open tools; ``"xc3s"`` or ``"xc6s"``, for which a
        project for Xilinx ISE is written.
    options : mapping of str to str
        Overrides of the platform's build, as amaranth takes them.
    lanes : int, optional
        Codes per clock at the camera's sensor port.
    blackboxes : str
        Verilog of modules that come with the vendor's software, without their content.
    """

    design: str
    board: str
    platform: Callable[[], Platform]
    top: Callable[[], Elaboratable]
    clocks_mhz: Mapping[str, float]
    family: str
    options: Mapping[str, str] = field(default_factory=dict)
    lanes: int | None = None
    blackboxes: str = ""
