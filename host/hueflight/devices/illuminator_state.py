# SPDX-License-Identifier: Apache-2.0
"""What an illuminator reports: its state, its counters, trigger phases and faults."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IlluminatorState:
    """What the board is doing.

    Attributes
    ----------
    armed : bool
        True if LEDs may fire.
    busy : bool
        True while a pulse train is running.
    bank : int
        Schedule bank of the last train.
    swap_pending : bool
        True if another bank is selected and waits for the next train.
    sequencing : bool
        True while a sequencer program is running.
    step : int
        Present step of the program.
    marker : int
        Value on the marker outputs.
    """

    armed: bool
    busy: bool
    bank: int
    swap_pending: bool
    sequencing: bool
    step: int
    marker: int


@dataclass(frozen=True)
class TriggerCounters:
    """Triggers since the counters were cleared; each counter stops at its largest value.

    Attributes
    ----------
    seen : int
        Edges of the trigger.
    served : int
        Edges that started a train.
    ignored : int
        Edges that did not.
    restarts : int
        Trains that the next trigger cut short.
    swaps : int
        Changes of the schedule bank.
    """

    seen: int
    served: int
    ignored: int
    restarts: int
    swaps: int


@dataclass(frozen=True)
class TriggerPhases:
    """Position of served external triggers within the board's clock, in ticks.

    Attributes
    ----------
    last, smallest, largest : int or None
        Phases since the statistics were cleared, None if there was no trigger.
    counts : tuple of int
        Number of triggers at each phase.
    """

    last: int | None
    smallest: int | None
    largest: int | None
    counts: tuple[int, ...]


@dataclass(frozen=True)
class IlluminatorFaults:
    """What went wrong since the faults were cleared.

    Attributes
    ----------
    watchdog : bool
        True if the watchdog disarmed the board.
    on_limited, duty_limited : frozenset of int
        Channels that were cut at the longest on-time, or held back by the duty limit.
    trigger_ignored : bool
        True if a trigger came while a train was running.
    saturated : bool
        True if a counter stands at its largest value.
    clock_failed : bool
        True if the board's clock failed (its PLL lost lock) and the board disarmed itself.
        Registers and schedules may be damaged: write them again before arming.
    reference_lost : bool
        True if the external clock was lost while the board ran from it; the board then runs from
        its oscillator, disarmed.
    clock_failures : int
        Number of failures of the clock since the board was configured; clearing the faults keeps
        it.
    """

    watchdog: bool
    on_limited: frozenset[int]
    duty_limited: frozenset[int]
    trigger_ignored: bool
    saturated: bool
    clock_failed: bool
    reference_lost: bool
    clock_failures: int
