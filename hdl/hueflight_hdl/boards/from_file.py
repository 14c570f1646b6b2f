# SPDX-License-Identifier: Apache-2.0
"""Targets for boards outside the package: a TOML file, or a Python file with a function."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from amaranth.build import Platform
from amaranth.vendor import LatticeECP5Platform, LatticeICE40Platform, XilinxPlatform

from . import ecp5_clocks, ecp5_illuminator, ice40, xc7
from .board_file import BoardFile, read_board_file
from .target import Options, Target, TargetError

_FAMILIES: dict[str, tuple[type[Any], Callable[..., Target], float]] = {
    "ecp5": (LatticeECP5Platform, ecp5_illuminator.illuminator_target, ecp5_clocks.PULSE_HZ),
    "ice40": (LatticeICE40Platform, ice40.illuminator_target, 100e6),
    "xc7": (XilinxPlatform, xc7.illuminator_target, xc7.PULSE_HZ),
}
"""Platform, function that returns the target, and clock of the pulse generator by default."""


def target_from_file(design: str, path: Path, options: Options, /) -> Target:
    """Return the target of a design on a board that a file describes.

    Parameters
    ----------
    design : str
        Name of the design.
    path : Path
        A board file (``.toml``, the illuminator only), or a Python file with a function
        ``target(design, options)`` that returns a `Target`.
    options : Options
        Choices of the user.

    Returns
    -------
    Target
        What can be built.

    Raises
    ------
    TargetError
        If the file cannot be read, or the design cannot be built from it.
    """
    if not path.is_file():
        raise TargetError(f"{path}: there is no such board file")
    if path.suffix == ".py":
        return _from_python(design, path, options)
    if design != "illuminator":
        raise TargetError(
            f"{path}: a TOML file describes boards for the illuminator; the {design} needs a "
            "Python file with a function target(design, options)"
        )
    return board_target(read_board_file(path), options)


def board_target(board: BoardFile, options: Options, /) -> Target:
    """Return the illuminator on a board.

    Parameters
    ----------
    board : BoardFile
        The board; it has a channel for each LED pin, unless its settings say otherwise. Settings
        of the user have precedence.
    options : Options
        Choices of the user.

    Returns
    -------
    Target
        What can be built.

    Raises
    ------
    TargetError
        If the clocks cannot be made or the settings do not fit.
    """
    leds = len(board.pins["led_pulse"])
    own = {"channels": leds, **board.settings}
    options = replace(options, settings={**own, **options.settings})
    _, illuminator_target, pulse_hz = _FAMILIES[board.family]
    made = illuminator_target(
        board.name,
        partial(_platform, board),
        options,
        armed="armed",
        leds=leds,
        pulse_hz=board.pulse_hz or pulse_hz,
        **({"edge": board.edge} if board.family == "ecp5" else {}),
    )
    return replace(made, loader=board.loader)


def _platform(board: BoardFile) -> Platform:
    """Return a platform with the board's part and pins."""
    base, *_ = _FAMILIES[board.family]
    content = {
        "device": board.device,
        "package": board.package,
        "default_clk": "clock",
        "resources": board.resources(),
        "connectors": (),
    }
    if board.speed:
        content["speed"] = board.speed
    try:
        return type("BoardFilePlatform", (base,), content)()
    except (ValueError, TypeError, AssertionError) as error:
        raise TargetError(f"board {board.name}: {error}") from error


def _from_python(design: str, path: Path, options: Options) -> Target:
    spec = importlib.util.spec_from_file_location(f"hueflight_board_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise TargetError(f"{path}: cannot be loaded as a Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    make: Callable[[str, Options], Target] | None = getattr(module, "target", None)
    if make is None:
        raise TargetError(f"{path}: has no function target(design, options)")
    return make(design, options)
