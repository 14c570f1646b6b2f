# SPDX-License-Identifier: Apache-2.0
"""A target: one design on one board, and how it is built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from amaranth.build import Platform
from amaranth.hdl import Elaboratable

from hueflight_protocol.errors import HueflightError
from hueflight_protocol.registers import RegisterMap


class TargetError(HueflightError):
    """The requested target or option does not exist."""


@dataclass(frozen=True)
class Options:
    """Choices of the user.

    Parameters
    ----------
    pins : Path, optional
        TOML file of pins, for boards whose wiring depends on the builder.
    lanes : int, optional
        Codes per clock at the camera's sensor port.
    settings : mapping
        Sizes and limits by name, see `boards.settings`; others are those of the board.
    """

    pins: Path | None = None
    lanes: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Target:
    """One design on one board.

    Parameters
    ----------
    design, board : str
        Names as on the command line.
    platform : callable
        Returns the Amaranth platform of the board, with the pins of the design.
    top : callable
        Returns the top-level module for that platform, with clocks and pin buffers.
    clocks_mhz : mapping of str to float
        Required frequency of each clock domain in MHz.
    family : str
        ``"ecp5"`` or ``"ice40"``, built with open tools; ``"xc3s"`` or ``"xc6s"``, for which a
        project for Xilinx ISE is written; ``"xc7"``, for which it is one for Vivado.
    options : mapping of str to str
        Build options of the Amaranth platform.
    lanes : int, optional
        Codes per clock at the camera's sensor port.
    blackboxes : str
        Verilog declarations of modules that come with the vendor's software.
    settings : mapping of str to int
        Sizes and limits of this build, see `boards.settings`.
    registers : RegisterMap, optional
        Registers of this build.
    loader : tuple of str
        Arguments of openFPGALoader that name the board or its cable.
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
    settings: Mapping[str, int] = field(default_factory=dict)
    registers: RegisterMap | None = None
    loader: tuple[str, ...] = ()
