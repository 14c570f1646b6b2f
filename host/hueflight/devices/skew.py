# SPDX-License-Identifier: Apache-2.0
"""Measures step and skew of an illuminator's fine delay lines with nothing but a wire.

An LED's output is led to the board's own trigger input. Each train then starts the next one, and
the time for one turn is a whole number of ticks, that of the loop rounded up: the trigger is
sampled once a tick. A turn moves the trigger by as many places within the clock, so the board's
counts of triggers by phase tell that number. Where a longer line makes it one larger, the loop is
exactly as long as a whole number of ticks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hueflight.devices.errors import DeviceError
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.pulse_schedule import ChannelPulse, PulseSchedule
from hueflight_protocol.illuminator_map import TriggerSource
from hueflight_protocol.typed_registers import illuminator as registers

PERIOD_TICKS = 480
"""Of the trains that start the loop. The pulse comes two clocks before their end, so that one is
always on its way when the trigger's source changes to the wire."""
WIDTH_TICKS = 8
LANES = 4
"""Ticks in a clock: with fewer, phases do not tell one number of ticks from the next."""
COARSE = 12
"""Settings that are tried first; a tick has more than twice as many."""
LEAST_TRIGGERS = 100
_WATCHDOG_MS = 1000


class SkewError(DeviceError):
    """Step and skew can't be measured: the wire, or the line behind an output, does not work."""


@dataclass(frozen=True)
class SkewMeasurement:
    """Step of the fine delay lines, and skew of the channels.

    Attributes
    ----------
    step_ns : float
        Step of the lines, in nanoseconds: one for all channels.
    skew_ns : tuple of float
        How much later each channel comes than the first that was measured, in nanoseconds, from its
        output register through the wire; from minus to plus two ticks. NaN if it was not measured.
    edges : tuple of tuple of float
        For each channel, the settings at which its loop is a whole number of ticks long.
    residual_ns : float
        Largest distance of an edge from the straight line, in nanoseconds: what nonlinearity,
        resolution (half a step) and steps that differ between channels leave.
    """

    step_ns: float
    skew_ns: tuple[float, ...]
    edges: tuple[tuple[float, ...], ...]
    residual_ns: float


def measure_skew(
    board: Illuminator,
    /,
    *,
    channels: Sequence[int] | None = None,
    connect: Callable[[int], None] = lambda channel: None,
    dwell_s: float = 0.005,
) -> SkewMeasurement:
    """Measure step and skew with the output of one channel after another as the trigger.

    The wire must be the same for all channels, or as long. A photodiode that sees all LEDs does as
    well, and measures the LEDs and their drivers with them. Each LED fires for 8 ticks in about
    570. Afterwards the board is disarmed and waits for external triggers, its lines are set as
    before, and one of its banks has the schedule of the last channel.

    Parameters
    ----------
    board : Illuminator
        The board; it must not be armed.
    channels : sequence of int, optional
        Channels that are measured, by default all.
    connect : callable
        Called with a channel before it is measured: has its output led to the trigger input.
    dwell_s : float
        Time for which triggers are counted at each setting, in seconds.

    Returns
    -------
    SkewMeasurement
        Step and skew, for `Illuminator.align`.

    Raises
    ------
    SkewError
        If there is no trigger from an output, or its time does not rise with the line's setting.
    DeviceError
        If the board is armed, or does not answer.
    ScheduleError
        If the board has no fine delay lines.
    """
    before = board.fine_delays()
    if board.capacity.lanes != LANES:
        raise SkewError(
            f"the board at {board.identity.place} has {board.capacity.lanes} ticks in a clock: "
            f"phases tell the length of a loop with {LANES}"
        )
    if not 0 < dwell_s < _WATCHDOG_MS / 2000:
        raise SkewError(f"dwell_s = {dwell_s}: must be more than 0 and less than half a second")
    wanted = range(board.capacity.channels) if channels is None else channels
    if not wanted:
        raise SkewError("channels: name at least one")
    if wrong := [channel for channel in wanted if not 0 <= channel < board.capacity.channels]:
        raise SkewError(f"channel {wrong[0]}: the board has 0 to {board.capacity.channels - 1}")
    board.check_disarmed()
    found: dict[int, tuple[int, tuple[float, ...]]] = {}
    filtered = board.board.read(registers.TriggerFilter)
    try:
        for channel in wanted:
            connect(channel)
            found[channel] = _edges(board, channel, dwell_s)
    finally:
        board.disarm()
        board.set_trigger(TriggerSource.EXTERNAL)
        board.board.write(filtered)
        board.set_fine_delays(before)
    return fit_line(found, board.capacity.channels, board.capacity.tick_ns)


def fit_line(
    found: dict[int, tuple[int, tuple[float, ...]]], channels: int, tick_ns: float, /
) -> SkewMeasurement:
    """Fit one step and the time of each channel to the settings at which loops are whole ticks.

    Parameters
    ----------
    found : dict of int to (int, tuple of float)
        For each channel, the length of its loop before the first edge, in ticks and modulo a clock,
        and its edges: the settings after which the loop is one tick longer each.
    channels : int
        Channels of the board.
    tick_ns : float
        Length of a tick, in nanoseconds.

    Returns
    -------
    SkewMeasurement
        The result of least squares over all edges.

    Raises
    ------
    SkewError
        If no channel has two edges, or the step comes out as 0 or less.
    """
    # ticks = base of the channel + step x setting, at each edge
    numbers = {channel: row for row, channel in enumerate(found)}
    places = [
        (numbers[channel], setting, first + edge)
        for channel, (first, edges) in found.items()
        for edge, setting in enumerate(edges)
    ]
    if not any(len(edges) > 1 for _, edges in found.values()):
        raise SkewError(
            "the lines move the outputs by less than a tick: their step can't be measured"
        )
    design = np.zeros((len(places), len(found) + 1))
    for row, (number, setting, _) in enumerate(places):
        design[row, number], design[row, -1] = 1.0, setting
    ticks = np.array([tick for _, _, tick in places], float)
    solved = np.linalg.lstsq(design, ticks, rcond=None)[0]
    if not solved[-1] > 0:
        raise SkewError(f"the step comes out as {solved[-1] * tick_ns:g} ns: must be more than 0")
    skew = np.full(channels, math.nan)
    for channel, number in numbers.items():
        late = solved[number] - solved[0]
        skew[channel] = ((late + LANES / 2) % LANES - LANES / 2) * tick_ns
    return SkewMeasurement(
        step_ns=float(solved[-1] * tick_ns),
        skew_ns=tuple(skew.tolist()),
        edges=tuple(found[c][1] if c in found else () for c in range(channels)),
        residual_ns=float(np.abs(design @ solved - ticks).max() * tick_ns),
    )


def turn_ticks(counts: Sequence[int], /) -> tuple[int, ...]:
    """Return the possible lengths of a loop, in ticks modulo a clock, from counts of triggers.

    Parameters
    ----------
    counts : sequence of int
        Triggers at each of the four phases.

    Returns
    -------
    tuple of int
        ``(0,)`` if all are at one phase, ``(2,)`` if they alternate, ``(1, 3)`` if they go round;
        empty if not every turn took as long.
    """
    used = [phase for phase, count in enumerate(counts) if count]
    even = max(counts) - min(counts[phase] for phase in used) <= 1 if used else False
    if len(used) == 1:
        return (0,)
    if len(used) == LANES and even:
        return (1, 3)
    if len(used) == 2 and even and used[1] - used[0] == 2:
        return (2,)
    return ()


def _edges(board: Illuminator, channel: int, dwell_s: float) -> tuple[int, tuple[float, ...]]:
    """Return the loop's ticks before the first edge, and the edges, of one channel."""
    steps = board.fine_delays().steps
    seen: dict[int, tuple[int, ...]] = {}
    _prepare(board, channel)

    def look(setting: int) -> tuple[int, ...]:
        if setting not in seen:
            seen[setting] = _turn(board, channel, setting, dwell_s)
        return seen[setting]

    def refine(low: int, high: int) -> None:
        if high - low > 1 and (look(low) != look(high) or not look(low)):
            middle = (low + high) // 2
            look(middle)
            refine(low, middle)
            refine(middle, high)

    coarse = [*range(0, steps - 1, COARSE), steps - 1]
    for setting in coarse:
        look(setting)
    for low, high in pairwise(coarse):
        refine(low, high)
    return staircase(seen, channel)


def staircase(seen: dict[int, tuple[int, ...]], channel: int, /) -> tuple[int, tuple[float, ...]]:
    """Return where the length of a loop rises, from what was seen at some settings.

    Parameters
    ----------
    seen : dict of int to tuple of int
        For each setting, what `turn_ticks` returned.
    channel : int
        Number of the channel, for messages.

    Returns
    -------
    tuple of (int, tuple of float)
        Ticks modulo a clock before the first edge, and the edges: each half-way between the last
        setting before it and the first one after it at which every turn took as long.

    Raises
    ------
    SkewError
        If it does not rise by one tick at a time.
    """
    clear = [(setting, ticks) for setting, ticks in sorted(seen.items()) if ticks]
    edges, levels = [], [clear[0][1]] if clear else []
    for (last, before), (setting, ticks) in pairwise(clear):
        if ticks != before:
            edges.append((last + setting) / 2)
            levels.append(ticks)
    for first in levels[0] if levels else ():
        if all((first + edge) % LANES in ticks for edge, ticks in enumerate(levels)):
            return first, tuple(edges)
    raise SkewError(
        f"channel {channel}: the loop does not get longer by one tick after another as the line's "
        f"setting rises: edges at {', '.join(f'{edge:g}' for edge in edges) or 'no setting'}; "
        "look at the trigger with an oscilloscope for slow or double edges"
    )


def _prepare(board: Illuminator, channel: int) -> None:
    """Load the train that a trigger starts: one pulse, shortly before its end."""
    tick = board.capacity.tick_ns
    lines = board.fine_delays()
    board.set_fine_delays(replace(lines, settings=(0,) * len(lines.settings)))
    pulses: list[tuple[ChannelPulse, ...]] = [()] * board.capacity.channels
    late = board.capacity.late_ns(channel)  # so that ticks are the same for all channels
    delay = (PERIOD_TICKS - 2 * LANES) * tick + late
    pulses[channel] = (ChannelPulse(delay, WIDTH_TICKS * tick),)
    board.play(PulseSchedule(tuple(pulses), period_ns=PERIOD_TICKS * tick))


def _turn(board: Illuminator, channel: int, setting: int, dwell_s: float) -> tuple[int, ...]:
    """Return the possible lengths of a loop at one setting of its line, LEDs off afterwards."""
    lines = board.fine_delays()
    settings = tuple(setting if k == channel else 0 for k in range(len(lines.settings)))
    board.set_fine_delays(replace(lines, settings=settings))
    board.set_trigger(TriggerSource.INTERNAL, period_ns=PERIOD_TICKS * board.capacity.tick_ns)
    board.arm(watchdog_ms=_WATCHDOG_MS)
    board.set_trigger(TriggerSource.EXTERNAL, filter_ns=0)
    board.board.write(registers.Clear(phase=1))
    time.sleep(dwell_s)
    counts = board.phases().counts
    board.disarm()  # lines can be set again, and the wire be moved
    if sum(counts) < LEAST_TRIGGERS:
        raise SkewError(
            f"channel {channel}: {sum(counts)} triggers in {dwell_s:g} s: lead its output to the "
            "trigger input, at the levels of that input"
        )
    return turn_ticks(counts)
