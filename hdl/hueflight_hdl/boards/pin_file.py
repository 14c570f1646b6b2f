# SPDX-License-Identifier: Apache-2.0
"""TOML files with the FPGA pins of boards whose wiring depends on the builder."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from amaranth.build import Attrs, Clock, Pins, Resource

from .target import TargetError


@dataclass(frozen=True)
class PinFile:
    """FPGA pins by signal name.

    Parameters
    ----------
    pins : mapping of str to tuple of str
        Package pins of each signal, bit 0 first.
    iostandard : str
        I/O standard of all of them.
    clock_hz : float, optional
        Frequency of the oscillator.
    """

    pins: Mapping[str, tuple[str, ...]]
    iostandard: str
    clock_hz: float | None = None

    def resource(self, name: str, direction: str, /) -> Resource:
        """Return the Amaranth resource of a signal."""
        pins = Pins(" ".join(self.pins[name]), dir=direction)
        attributes = Attrs(IOSTANDARD=self.iostandard)
        if name == "clock":
            return Resource(name, 0, pins, Clock(self.clock_hz), attributes)
        return Resource(name, 0, pins, attributes)


def read_pins(path: Path | None, board: str, wanted: Mapping[str, int], /) -> PinFile:
    """Read a pin file.

    Parameters
    ----------
    path : Path, optional
        The file that the user gave.
    board : str
        Name of the board, for error messages.
    wanted : mapping of str to int
        Number of pins of each signal; with a signal ``clock``, ``clock_hz`` is required too.

    Returns
    -------
    PinFile
        The checked content.

    Raises
    ------
    TargetError
        If the file is missing or invalid, a signal is missing or unknown, or a pin is used
        twice; the message says what the file must contain.
    """
    names = ", ".join(
        f"{name} ({count} pins)" if count > 1 else name for name, count in wanted.items()
    )
    frequency = " clock_hz," if "clock" in wanted else ""
    if path is None:
        raise TargetError(
            f"the wiring of {board} depends on the builder and is not guessed: give --pins "
            f"FILE.toml with iostandard,{frequency} and the FPGA pins of {names}"
        )
    try:
        content = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise TargetError(f"{path}: {error}") from error
    iostandard = content.pop("iostandard", None)
    clock_hz = content.pop("clock_hz", None)
    if not isinstance(iostandard, str):
        raise TargetError(f'{path}: iostandard = {iostandard!r}: must be a name such as "LVCMOS33"')
    if "clock" in wanted and not (isinstance(clock_hz, int | float) and clock_hz > 0):
        raise TargetError(
            f"{path}: clock_hz = {clock_hz!r}: must be the frequency of the oscillator in Hz"
        )
    if unknown := set(content) - set(wanted):
        raise TargetError(
            f"{path}: unknown name {', '.join(sorted(unknown))}: the names are {names}"
        )
    pins = {}
    for name, count in wanted.items():
        value = content.get(name)
        found = [value] if isinstance(value, str) else value
        if not isinstance(found, list) or len(found) != count:
            raise TargetError(f"{path}: {name} = {value!r}: must be {count} pins of {board}")
        pins[name] = tuple(map(str, found))
    every = [pin for group in pins.values() for pin in group]
    if twice := {pin for pin in every if every.count(pin) > 1}:
        raise TargetError(f"{path}: {', '.join(sorted(twice))} is named more than once")
    return PinFile(pins, iostandard, None if clock_hz is None else float(clock_hz))
