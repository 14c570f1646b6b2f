# SPDX-License-Identifier: Apache-2.0
"""Reference model of the pulse generator in Python, at tick resolution.

It implements the rules of ``docs/illuminator.md`` independently of the registers and pipelines of
the gateware; the caller adds the total latency. Time is counted in ticks from tick 0
of clock 0; a clock is `lanes` ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .config import MIN_SPACING, Limits


@dataclass(frozen=True)
class Pulse:
    """One pulse of a channel: begins `delay` ticks after the trigger, lasts `width` ticks."""

    delay: int
    width: int


@dataclass(frozen=True)
class Schedule:
    """The content of a bank.

    Parameters
    ----------
    period : int
        Length of a train in ticks.
    enable : int
        Bit k: channel k fires.
    pulses : sequence of sequences of Pulse
        For each channel.
    """

    period: int
    enable: int
    pulses: Sequence[Sequence[Pulse]]


@dataclass(frozen=True)
class Choice:
    """Bank, mask and marker that a train takes over in the clock of its trigger."""

    bank: int
    mask: int = -1
    marker: int = 0


@dataclass(frozen=True)
class Train:
    """A train: a trigger that was served."""

    tick: int
    choice: Choice
    restarted: bool


def find_edges(
    samples: np.ndarray, /, *, lanes: int, falling: bool = False, width: int = 1
) -> np.ndarray:
    """Return the ticks of the triggers in an input: the first edge of each clock.

    Parameters
    ----------
    samples : numpy.ndarray of bool, shape (ticks,)
        The input at each tick; there is no edge at tick 0.
    lanes : int
        Ticks per clock.
    falling : bool
        Look for falling edges.
    width : int
        Ticks for which the input must keep its level before and after an edge; it keeps the first
        and the last one for ever.
    """
    level = samples.astype(bool) ^ falling
    changes = 1 + np.flatnonzero(level[1:] != level[:-1])
    apart = np.diff(changes, prepend=-width, append=len(level) + width)
    ticks = changes[level[changes] & (apart[:-1] >= width) & (apart[1:] >= width)]
    _, first = np.unique(ticks // lanes, return_index=True)
    return ticks[first]


def serve(
    triggers: Sequence[int] | np.ndarray,
    choose: Callable[[int], Choice],
    periods: Sequence[int],
    *,
    lanes: int,
    restart: bool = False,
) -> tuple[list[Train], int]:
    """Return the trains that triggers begin, and how many triggers are ignored.

    Parameters
    ----------
    triggers : sequence of int
        Ticks, ascending.
    choose : callable
        Clock of a trigger to what its train takes over.
    periods : sequence of int
        Length of a train in ticks, for each bank.
    lanes : int
        Ticks per clock.
    restart : bool
        A trigger during a train begins a new one.
    """
    trains: list[Train] = []
    ignored = 0
    spaced_from = busy_until = 0
    for tick in triggers:
        clock = int(tick) // lanes
        busy = clock < busy_until
        if (busy and not restart) or clock < spaced_from:
            ignored += 1
            continue
        choice = choose(clock)
        trains.append(Train(int(tick), choice, busy))
        spaced_from = clock + MIN_SPACING
        busy_until = clock + max(periods[choice.bank] // lanes, MIN_SPACING)
    return trains, ignored


def render(
    trains: Sequence[Train],
    banks: Sequence[Schedule],
    *,
    channel: int,
    lanes: int,
    ticks: int,
    widest: int,
) -> np.ndarray:
    """Return what a channel demands of its LED, before the limits.

    Parameters
    ----------
    trains : sequence of Train
    banks : sequence of Schedule
    channel : int
    lanes : int
        Ticks per clock.
    ticks : int
        Length of the result.
    widest : int
        Wider pulses are taken as this wide.

    Returns
    -------
    numpy.ndarray of bool, shape (ticks,)
    """
    demand = np.zeros(ticks, bool)
    for slot in range(len(banks[0].pulses[channel])):
        begun: list[tuple[int, int]] = []
        for train, following in zip(trains, [*trains[1:], None], strict=False):
            bank = banks[train.choice.bank]
            if not bank.enable & train.choice.mask & 1 << channel:
                continue
            pulse = bank.pulses[channel][slot]
            # a train lives for the whole clocks up to the next one's trigger
            if following is not None:
                life = following.tick // lanes - train.tick // lanes
                if pulse.delay // lanes >= life:
                    continue
            begin = train.tick + pulse.delay
            if begun and begun[-1][0] // lanes == begin // lanes:
                begun.pop()  # at most one a clock: the newer train's
            begun.append((begin, begin + min(pulse.width, widest)))
        for (begin, end), following_pulse in zip(begun, [*begun[1:], None], strict=False):
            until = end if following_pulse is None else min(end, following_pulse[0])
            demand[min(begin, ticks) : min(until, ticks)] = True
    return demand


def limit(demand: np.ndarray, limits: Limits, /, *, lanes: int) -> np.ndarray:
    """Return the part of a demand that passes the limits.

    Parameters
    ----------
    demand : numpy.ndarray of bool, shape (ticks,)
        Whole clocks.
    limits : Limits
    lanes : int
        Ticks per clock.

    Returns
    -------
    numpy.ndarray of bool, shape (ticks,)
    """
    padded = np.concatenate(([False], demand, [False])).astype(np.int8)
    change = np.diff(padded)
    begins, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
    within = demand.copy()
    for run in np.flatnonzero(ends - begins > limits.max_on_ticks):
        within[begins[run] + limits.max_on_ticks : ends[run]] = False
    return within & np.repeat(_duty_allows(demand, limits, lanes=lanes), lanes)


def _duty_allows(demand: np.ndarray, limits: Limits, *, lanes: int) -> np.ndarray:
    divisor = limits.duty_divisor
    on = demand.reshape(-1, lanes).sum(axis=1)
    allows = np.ones(len(on), bool)
    if divisor == 1:
        return allows
    # whole clocks are added up: a stretch of ticks may have lanes - 1 more at either end
    threshold = divisor * limits.burst_ticks - 2 * (lanes - 1)
    changes = divisor * on - lanes
    walk = np.cumsum(changes)
    if (walk - np.minimum.accumulate(np.minimum(walk, 0))).max(initial=0) <= threshold:
        return allows  # the level never comes near the limit, let alone the ceiling
    ceiling = 1
    while ceiling < 2 * divisor * limits.burst_ticks:
        ceiling *= 2
    level = 0
    for clock, change in enumerate(changes.tolist()):
        level = min(max(level, 0), ceiling) + change
        allows[clock] = level <= threshold
    return allows


@dataclass(frozen=True)
class Step:
    """One step of a sequencer program.

    Parameters
    ----------
    count : int
        Units (trains, or frame syncs) for which it fires; 0 skips the step.
    idle : int
        Dark units after it.
    choice : Choice
        Bank, mask and marker while it fires.
    """

    count: int
    idle: int
    choice: Choice


def program_units(program: Sequence[Step], /) -> list[Choice]:
    """Return what each unit of one pass through a program has, in order."""
    dark = Choice(0, mask=0, marker=0)
    units: list[Choice] = []
    for step in program:
        if step.count:
            units += [step.choice] * step.count + [dark] * step.idle
    return units
