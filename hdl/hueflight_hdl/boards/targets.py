# SPDX-License-Identifier: Apache-2.0
"""The registry of targets: which design can be built for which board."""

from __future__ import annotations

from importlib import import_module

from .target import Options, Target, TargetError

_MAKERS = {
    ("illuminator", "ulx3s-85f"): "ulx3s:illuminator",
    ("illuminator", "ecpix5-85f"): "ecpix5:illuminator",
    ("illuminator", "hx8k"): "hx8k:illuminator",
    ("illuminator", "xem3010"): "xem3010:illuminator",
    ("camera", "ulx3s-85f"): "ulx3s:camera",
    ("camera", "ecpix5-85f"): "ecpix5:camera",
    ("camera", "xem6310"): "xem6310:camera",
}
_WITH_PINS = ("xem3010", "xem6310")


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
        Names as on the command line.
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
    maker = _MAKERS.get((design, board))
    if maker is None:
        raise TargetError(
            f"the {design} cannot be built for {board!r}: choose one of "
            f"{', '.join(boards_of(design))}"
        )
    if options.lanes is not None and design != "camera":
        raise TargetError(
            f"--lanes {options.lanes}: only the camera has a sensor port with lanes; leave it out"
        )
    if options.pins is not None and board not in _WITH_PINS:
        raise TargetError(f"--pins {options.pins}: the pins of {board} are fixed; leave it out")
    module, function = maker.split(":")
    return getattr(import_module(f".{module}", __package__), function)(options)
