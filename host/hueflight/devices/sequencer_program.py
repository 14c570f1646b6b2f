"""Programs of the illuminator's sequencer: what fires, for how many units, step by step."""

from __future__ import annotations

from dataclasses import dataclass

from hueflight_protocol.typed_registers.illuminator import StepCount

FOREVER = StepCount.VALUE_MAX
"""Longest count: three months of the paper's frames."""


@dataclass(frozen=True)
class ProgramStep:
    """One step. A unit is a train, or a frame of the camera.

    Attributes
    ----------
    count : units for which it fires.
    bank : schedule, 0 or 1.
    channels : that fire; None for all.
    marker : 0 to 255, noted by the camera in each frame's header.
    idle : dark units after it, with marker 0.
    """

    count: int
    bank: int = 0
    channels: frozenset[int] | None = None
    marker: int = 0
    idle: int = 0


def each_alone(
    channels: int, units: int, /, *, idle: int = 0, bank: int = 0, stay: bool = False
) -> tuple[ProgramStep, ...]:
    """Each channel alone, marked with its number: the reference captures of a calibration.

    Parameters
    ----------
    channels : how many, from channel 0.
    units : for each.
    idle : dark units between them.
    bank : schedule.
    stay : the last channel goes on until the program is stopped.
    """
    steps = [
        ProgramStep(units, bank, frozenset({channel}), channel, idle) for channel in range(channels)
    ]
    if stay and steps:
        steps[-1] = ProgramStep(FOREVER, bank, frozenset({channels - 1}), channels - 1)
    return tuple(steps)


def dark(units: int = FOREVER, /, *, marker: int = 0) -> tuple[ProgramStep, ...]:
    """No LED at all."""
    return (ProgramStep(units, 0, frozenset(), marker),)


def alternate(units: int = 1, /) -> tuple[ProgramStep, ...]:
    """Both schedules in turn, marked 0 and 1; played in a loop, they range without ambiguity."""
    return (ProgramStep(units, 0, None, 0), ProgramStep(units, 1, None, 1))
