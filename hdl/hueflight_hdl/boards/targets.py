# SPDX-License-Identifier: Apache-2.0
"""The registry of targets: which design can be built for which board."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

from .from_file import target_from_file
from .settings import check_settings
from .target import Options, Target, TargetError

_MAKERS = {
    **{
        (design, f"{board}-{size}"): f"{board}:{design}:{size}"
        for board, sizes in (("ulx3s", ("85f", "45f", "25f", "12f")), ("ecpix5", ("85f", "45f")))
        for design in ("illuminator", "camera")
        for size in sizes
    },
    ("illuminator", "hx8k"): "hx8k:illuminator",
    ("illuminator", "xem3010"): "xem3010:illuminator",
    ("camera", "xem6310"): "xem6310:camera",
}
"""Module and function of each target; boards with devices of several sizes have the size too."""
_LOADERS = {
    "ulx3s": ("-b", "ulx3s"),
    "ecpix5": ("-c", "ft2232"),
    "hx8k": ("-b", "ice40_generic", "-c", "ft2232"),
}
"""Arguments of openFPGALoader for boards, by the module of `_MAKERS`."""
ENTRY_POINTS = "hueflight.boards"
"""Entry points of other distributions: functions of design and `Options` that return a `Target`."""
_FIXED = {board for _, board in _MAKERS} - {"xem3010", "xem6310"}
"""Boards whose pins are known; a Python file or another distribution may want a file of pins."""


def boards_of(design: str) -> list[str]:
    """Return the boards that a design can be built for."""
    return [board for made, board in _MAKERS if made == design]


def designs() -> list[str]:
    """Return the designs that can be built."""
    return sorted({design for design, _ in _MAKERS})


def find_target(design: str, board: str, options: Options | None = None, /) -> Target:
    """Return the target of a design on a board.

    Parameters
    ----------
    design, board : str
        Names as on the command line; the board may be the path of a board file, or the name of an
        entry point of another distribution.
    options : Options, optional
        Choices of the user.

    Returns
    -------
    Target
        What can be built.

    Raises
    ------
    TargetError
        If the combination does not exist or an option does not apply to it; the message lists
        the valid choices.
    """
    options = options or Options()
    if design not in designs():
        raise TargetError(f"there is no design {design!r}: choose one of {', '.join(designs())}")
    options = replace(options, settings=check_settings(design, options.settings))
    if options.lanes is not None and design != "camera":
        raise TargetError(
            f"--lanes {options.lanes}: only the camera has a sensor port with lanes; leave it out"
        )
    if options.pins is not None and (board.endswith(".toml") or board in _FIXED):
        raise TargetError(f"--pins {options.pins}: the pins of {board} are fixed; leave it out")
    if board.endswith((".toml", ".py")):
        return target_from_file(design, Path(board), options)
    maker = _MAKERS.get((design, board))
    if maker is None:
        installed = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
        if board in installed:
            return installed[board].load()(design, options)
        others = f", {', '.join(installed)}" if installed else ""
        raise TargetError(
            f"the {design} cannot be built for {board!r}: choose one of "
            f"{', '.join(boards_of(design))}{others}, or give the path of a board file "
            "(.toml or .py)"
        )
    module, function, *size = maker.split(":")
    made = getattr(import_module(f".{module}", __package__), function)(options, *size)
    return replace(made, loader=_LOADERS.get(module, ()))
