# SPDX-License-Identifier: Apache-2.0
"""Programs of the illuminator's sequencer: which LEDs fire, and for how long, step by step."""

from __future__ import annotations

from dataclasses import dataclass

from hueflight_protocol.typed_registers.illuminator import StepCount

FOREVER = StepCount.VALUE_MAX
"""Largest count of a step: about fifty days of the paper's frames."""


@dataclass(frozen=True)
class ProgramStep:
    """One step of a program, whose length is counted in pulse trains or in camera frames.

    Attributes
    ----------
    count : int
        Length of the step, in trains or frames.
    bank : int
        Schedule bank, 0 or 1.
    channels : frozenset of int or None
        Channels that fire, None for all.
    marker : int
        Number that the camera writes into the header of each frame, 0 to 255.
    idle : int
        Length of a dark time after the step, with marker 0.
    """

    count: int
    bank: int = 0
    channels: frozenset[int] | None = None
    marker: int = 0
    idle: int = 0


def each_alone(
    channels: int, units: int, /, *, idle: int = 0, bank: int = 0, stay: bool = False
) -> tuple[ProgramStep, ...]:
    """Return a program in which each channel fires alone, marked with its number.

    Parameters
    ----------
    channels : int
        Number of channels, from channel 0.
    units : int
        Length of each step, in trains or frames.
    idle : int
        Length of the dark time between steps.
    bank : int
        Schedule bank.
    stay : bool
        True if the last channel goes on until the program is stopped.

    Returns
    -------
    tuple of ProgramStep
        The program.
    """
    steps = [
        ProgramStep(units, bank, frozenset({channel}), channel, idle) for channel in range(channels)
    ]
    if stay and steps:
        steps[-1] = ProgramStep(FOREVER, bank, frozenset({channels - 1}), channels - 1)
    return tuple(steps)


def dark(units: int = FOREVER, /, *, marker: int = 0) -> tuple[ProgramStep, ...]:
    """Return a program in which no LED fires.

    Parameters
    ----------
    units : int
        Length, in trains or frames.
    marker : int
        Number in the headers of the frames.

    Returns
    -------
    tuple of ProgramStep
        The program.
    """
    return (ProgramStep(units, 0, frozenset(), marker),)


def alternate(units: int = 1, /) -> tuple[ProgramStep, ...]:
    """Return a program that plays both schedule banks in turn, marked 0 and 1.

    Parameters
    ----------
    units : int
        Length of each step, in trains or frames.

    Returns
    -------
    tuple of ProgramStep
        The program; played in a loop, two different schedules resolve the ambiguity of range.
    """
    return (ProgramStep(units, 0, None, 0), ProgramStep(units, 1, None, 1))
