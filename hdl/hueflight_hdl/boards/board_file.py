# SPDX-License-Identifier: Apache-2.0
"""Boards described by a TOML file outside the package: family, device, clock and pins."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from amaranth.build import Attrs, Clock, Pins, Resource, Subsignal

from .ecp5_pll import EDGES
from .settings import check_settings
from .target import TargetError

FAMILIES = ("ecp5", "ice40", "xc7")
SIGNALS = {
    "rx": "i",
    "tx": "o",
    "trigger": "i",
    "trigger_out": "o",
    "frame_sync": "i",
    "missed": "o",
    "armed": "o",
    "led_pulse": "o",
    "marker": "o",
}
"""Signals of the illuminator and their directions."""
OPTIONAL = {"reference": "i", "clock_out": "o"}
"""Signals that a board may have: an external clock, and the clock in use."""
MARKERS = 8
_TOP = (
    *("name", "family", "device", "package", "speed", "loader"),
    *("clock", "pins", "attributes", "settings"),
)


@dataclass(frozen=True)
class BoardFile:
    """The content of a board file.

    Parameters
    ----------
    name : str
        Name of the board.
    family : str
        One of `FAMILIES`.
    device, package, speed : str
        Part, as the Amaranth platform of the family names it.
    clock_pin : str
        Pin of the oscillator.
    clock_hz : float
        Its frequency.
    pulse_hz : float or None
        Frequency of the domain `pulse`; by default that of the family.
    edge : str or None
        Edge of an ECP5 with the LEDs, ``"left"`` or ``"right"``; an external clock needs it.
    pins : mapping of str to tuple of str
        Package pins of each signal, bit 0 first.
    attributes : mapping of str to mapping
        Attributes of pins for each signal; ``default`` is for those that have none.
    settings : mapping of str to int
        Sizes and limits, see `boards.settings`.
    loader : tuple of str
        Arguments of openFPGALoader that name the board or its cable.
    """

    name: str
    family: str
    device: str
    package: str
    speed: str
    clock_pin: str
    clock_hz: float
    pulse_hz: float | None
    edge: str | None
    pins: Mapping[str, tuple[str, ...]]
    attributes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    settings: Mapping[str, int] = field(default_factory=dict)
    loader: tuple[str, ...] = ()

    def resources(self) -> list[Resource]:
        """Return the Amaranth resources of all signals."""
        clock = Pins(self.clock_pin, dir="i")
        lines = [Subsignal(name, self._pins(name), self._attrs(name)) for name in ("rx", "tx")]
        return [
            Resource("clock", 0, clock, Clock(self.clock_hz), self._attrs("clock")),
            Resource("uart", 0, *lines),
            *(
                Resource(name, 0, self._pins(name), self._attrs(name))
                for name in self.pins
                if name not in ("rx", "tx")
            ),
        ]

    def _pins(self, name: str) -> Pins:
        return Pins(" ".join(self.pins[name]), dir={**SIGNALS, **OPTIONAL}[name])

    def _attrs(self, name: str) -> Attrs:
        return Attrs(**self.attributes.get(name, self.attributes.get("default", {})))


def read_board_file(path: Path, /) -> BoardFile:
    """Read a board file.

    Parameters
    ----------
    path : Path
        TOML file; ``docs/porting.md`` describes it.

    Returns
    -------
    BoardFile
        The checked content.

    Raises
    ------
    TargetError
        If the file cannot be read, something is missing or unknown, or a pin is used twice; the
        message names the entry and what it must be.
    """
    try:
        content = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise TargetError(f"{path}: {error}") from error
    reader = _Reader(path, content)
    reader.only(content, _TOP, "")
    family = reader.text("family")
    if family not in FAMILIES:
        raise TargetError(f"{path}: family = {family!r}: must be one of {', '.join(FAMILIES)}")
    if family == "ice40" and "speed" in content:
        raise TargetError(f"{path}: speed: the device of an ice40 board has it; leave it out")
    clock = reader.table("clock")
    reader.only(clock, ("pin", "hz", "pulse_hz", "edge"), "clock.")
    edge = clock.get("edge")
    if "edge" in clock and (family != "ecp5" or edge not in EDGES):
        raise TargetError(
            f"{path}: clock.edge = {edge!r}: must be {' or '.join(EDGES)}, on an ecp5 board"
        )
    pins = reader.pins(reader.table("pins"), clock.get("pin"))
    attributes = reader.table("attributes", {})
    known = ("default", "clock", *SIGNALS, *OPTIONAL)
    reader.only(attributes, known, "attributes.")
    if wrong := [name for name, table in attributes.items() if not isinstance(table, dict)]:
        raise TargetError(f"{path}: attributes.{wrong[0]}: must be a table of NAME = VALUE")
    try:
        settings = check_settings("illuminator", reader.table("settings", {}))
    except TargetError as error:
        raise TargetError(f"{path}: settings: {error}") from error
    return BoardFile(
        name=reader.text("name"),
        family=family,
        device=reader.text("device"),
        package=reader.text("package"),
        speed=reader.text("speed") if family != "ice40" else "",
        clock_pin=str(clock.get("pin")),
        clock_hz=reader.frequency(clock, "hz"),
        pulse_hz=reader.frequency(clock, "pulse_hz") if "pulse_hz" in clock else None,
        edge=edge,
        pins=pins,
        attributes={
            name: {key: str(value) for key, value in table.items()}
            for name, table in attributes.items()
        },
        settings=settings,
        loader=reader.texts("loader"),
    )


class _Reader:
    """Looks up entries of a file, and names them in errors."""

    def __init__(self, path: Path, content: Mapping[str, object]) -> None:
        self.path = path
        self.content = content

    def only(self, table: Mapping[str, object], names: tuple[str, ...], prefix: str) -> None:
        """Refuse names that nothing reads."""
        if unknown := [name for name in table if name not in names]:
            raise TargetError(
                f"{self.path}: unknown name {prefix}{unknown[0]}: the names are {', '.join(names)}"
            )

    def text(self, name: str) -> str:
        """Return an entry that must be a text."""
        value = self.content.get(name)
        if not isinstance(value, str) or not value:
            raise TargetError(f"{self.path}: {name} = {value!r}: must be a text")
        return value

    def texts(self, name: str) -> tuple[str, ...]:
        """Return an entry that must be a list of texts; none where it is not there."""
        value = self.content.get(name, [])
        if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
            raise TargetError(f"{self.path}: {name} = {value!r}: must be a list of texts")
        return tuple(value)

    def table(self, name: str, default: object = None) -> dict[str, Any]:
        """Return an entry that must be a table."""
        value = self.content.get(name, default)
        if value is None:
            raise TargetError(f"{self.path}: [{name}] is missing")
        if not isinstance(value, dict):
            raise TargetError(f"{self.path}: {name} = {value!r}: must be a table")
        return value

    def frequency(self, table: Mapping[str, object], name: str) -> float:
        """Return an entry that must be a frequency in Hz."""
        value = table.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or value <= 0:
            raise TargetError(f"{self.path}: clock.{name} = {value!r}: must be a frequency in Hz")
        return float(value)

    def pins(self, table: Mapping[str, object], clock_pin: object) -> dict[str, tuple[str, ...]]:
        """Return the pins of all signals."""
        self.only(table, (*SIGNALS, *OPTIONAL), "pins.")
        if not isinstance(clock_pin, str):
            raise TargetError(f"{self.path}: clock.pin = {clock_pin!r}: must be a pin")
        found: dict[str, tuple[str, ...]] = {}
        for name in (*SIGNALS, *(name for name in OPTIONAL if name in table)):
            value = table.get(name)
            several = name in ("led_pulse", "marker")
            group = value if isinstance(value, list) else [value]
            if (
                isinstance(value, list) != several
                or not group
                or not all(isinstance(pin, str) and pin for pin in group)
                or (name == "marker" and len(group) != MARKERS)
            ):
                wanted = {"led_pulse": "a list of pins", "marker": f"a list of {MARKERS} pins"}
                raise TargetError(
                    f"{self.path}: pins.{name} = {value!r}: must be {wanted.get(name, 'a pin')}"
                )
            found[name] = tuple(group)
        every = [clock_pin, *(pin for group in found.values() for pin in group)]
        if twice := {pin for pin in every if every.count(pin) > 1}:
            raise TargetError(f"{self.path}: {', '.join(sorted(twice))} is used more than once")
        return found
