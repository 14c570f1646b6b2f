# SPDX-License-Identifier: Apache-2.0
"""Pulse schedules: when LEDs fire, in nanoseconds, and rounded to the ticks of a board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from hueflight.devices.fine_delays import FineDelays, ticks_of
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument
from hueflight.model.schedules import Schedule
from hueflight_protocol.illuminator_map import MAX_PERIOD_TICKS, MIN_PERIOD_CLOCKS


class ScheduleError(HueflightError):
    """A schedule or program that the illuminator can't or must not play."""


@dataclass(frozen=True)
class ChannelPulse:
    """One pulse of a channel.

    Attributes
    ----------
    delay_ns : float
        Time from the trigger to the rising edge, in nanoseconds.
    width_ns : float
        Width of the drive pulse, in nanoseconds.
    """

    delay_ns: float
    width_ns: float = 10.0


@dataclass(frozen=True)
class PulseSchedule:
    """Pulses of every channel in one period.

    Attributes
    ----------
    channels : tuple of tuple of ChannelPulse
        Pulses of each channel; channels of the board beyond these stay off.
    period_ns : float
        Period of the pulse trains, in nanoseconds.
    overlap : bool
        True if pulses may coincide, of two channels or of one.
    """

    channels: tuple[tuple[ChannelPulse, ...], ...]
    period_ns: float
    overlap: bool = False

    @classmethod
    def even(
        cls,
        channels: int,
        /,
        *,
        spacing_ns: float = 30.0,
        width_ns: float = 10.0,
        period_ns: float = 320.0,
    ) -> PulseSchedule:
        """Return a schedule of one pulse for each channel, evenly spaced.

        Parameters
        ----------
        channels : int
            Number of channels.
        spacing_ns, width_ns, period_ns : float
            Time from pulse to pulse, width of the pulses, and period, in nanoseconds; the
            defaults are the paper's (Table 1).

        Returns
        -------
        PulseSchedule
            The schedule.
        """
        pulses = tuple((ChannelPulse(spacing_ns * k, width_ns),) for k in range(channels))
        return cls(pulses, period_ns)

    @classmethod
    def of(cls, instrument: Instrument, /) -> PulseSchedule:
        """What an instrument's description says: delays of its bands, period and drive width.

        Raises
        ------
        ScheduleError
            If the instrument has no period.
        """
        timing = instrument.timing
        if timing.period_ns is None:
            raise ScheduleError(
                f"instrument {instrument.name!r} has no timing.period_ns: state the length of one "
                "LED train"
            )
        width = timing.pulse_width_ns
        pulses = tuple(
            tuple(ChannelPulse(delay, width) for delay in band.delays_ns)
            for band in instrument.bands
        )
        return cls(pulses, timing.period_ns)


@dataclass(frozen=True)
class ChannelLimit:
    """Limits of a channel that the board enforces.

    Attributes
    ----------
    on_ticks : int
        Longest time on without a pause, in ticks.
    burst_ticks, duty_divisor : int
        In any stretch of L ticks the channel is on for at most L / `duty_divisor` + `burst_ticks`.
    """

    on_ticks: int
    burst_ticks: int
    duty_divisor: int


@dataclass(frozen=True)
class Capacity:
    """What an illuminator is built for.

    Attributes
    ----------
    channels, pulses, steps, lanes : int
        Number of LED channels, of pulses of each, of steps of a program, and of ticks per clock.
    tick_ns : float
        Length of a tick, in nanoseconds.
    limits : tuple of ChannelLimit
        Limits of each channel.
    fine : FineDelays or None
        How its fine delay lines are set; None if it has none.
    """

    channels: int
    pulses: int
    steps: int
    lanes: int
    tick_ns: float
    limits: tuple[ChannelLimit, ...]
    fine: FineDelays | None = None

    def late_ns(self, channel: int, /) -> float:
        """Return what a channel adds to its delay in ticks.

        Parameters
        ----------
        channel : int
            Number of the channel.

        Returns
        -------
        float
            Time in nanoseconds, 0 without fine delay lines.
        """
        return 0.0 if self.fine is None else self.fine.late_ns(channel)

    @property
    def min_period_ticks(self) -> int:
        """Shortest period of a train, in ticks."""
        return MIN_PERIOD_CLOCKS * self.lanes


@dataclass(frozen=True)
class TickPulse:
    """One pulse in ticks.

    Attributes
    ----------
    delay : int
        Time from the trigger to the rising edge.
    width : int
        Width of the pulse.
    """

    delay: int
    width: int


@dataclass(frozen=True)
class TickSchedule:
    """A schedule as the board holds it.

    Attributes
    ----------
    channels : tuple of tuple of TickPulse
        Pulses of each channel.
    period : int
        Period in ticks.
    busy : int
        Time after a trigger in which the board takes no other, in ticks; shorter than the period
        by one clock, so that a trigger which is not synchronous can come early.
    tick_ns : float
        Length of a tick, in nanoseconds.
    delay_error_ns, width_error_ns, period_error_ns : float
        Largest rounding errors, in nanoseconds; that of the delays is what fine delays and known
        skew leave.
    late_ns : tuple of float
        What each channel adds to its ticks, in nanoseconds; see `FineDelays.late_ns`.
    """

    channels: tuple[tuple[TickPulse, ...], ...]
    period: int
    busy: int
    tick_ns: float
    delay_error_ns: float
    width_error_ns: float
    period_error_ns: float
    late_ns: tuple[float, ...]

    @property
    def in_ns(self) -> Schedule:
        """Delays and period as the board plays them."""
        delays = tuple(
            tuple(max(0.0, pulse.delay * self.tick_ns + late) for pulse in pulses)
            for pulses, late in zip(self.channels, self.late_ns, strict=True)
        )
        return Schedule(delays, self.period * self.tick_ns)


def to_ticks(schedule: PulseSchedule, capacity: Capacity, /) -> TickSchedule:
    """Round a schedule to ticks, and check that the board will play it unchanged.

    Parameters
    ----------
    schedule : PulseSchedule
        Schedule in nanoseconds.
    capacity : Capacity
        What the board was built for.

    Returns
    -------
    TickSchedule
        The schedule in ticks, with the errors of rounding.

    Raises
    ------
    ScheduleError
        If it does not fit the board, breaks a channel's limits, or pulses coincide without
        `overlap`.
    """
    tick = capacity.tick_ns
    period = _ticks(schedule.period_ns, tick, "period_ns")
    shortest = capacity.min_period_ticks
    if not shortest <= period <= MAX_PERIOD_TICKS:
        raise ScheduleError(
            f"period_ns = {schedule.period_ns}: must be from {shortest * tick:g} to "
            f"{MAX_PERIOD_TICKS * tick:g} ns, in ticks of {tick:g} ns"
        )
    if len(schedule.channels) > capacity.channels:
        raise ScheduleError(f"{len(schedule.channels)} channels: the board has {capacity.channels}")
    errors: list[tuple[float, float]] = []
    channels = []
    for number, pulses in enumerate(schedule.channels):
        if len(pulses) > capacity.pulses:
            raise ScheduleError(
                f"channel {number}: {len(pulses)} pulses, the board has {capacity.pulses} a channel"
            )
        made = []
        late = capacity.late_ns(number)
        for pulse in pulses:
            made.append(_pulse(pulse, number, schedule.period_ns, period, tick, late))
            errors.append(
                (
                    made[-1].delay * tick + late - pulse.delay_ns,
                    made[-1].width * tick - pulse.width_ns,
                )
            )
        _check_limits(number, made, period, capacity)
        channels.append(tuple(made))
    if not schedule.overlap:
        _check_apart(channels, period, tick)
    last = max((pulse.delay for pulses in channels for pulse in pulses), default=0)
    return TickSchedule(
        channels=tuple(channels),
        period=period,
        busy=max(period - capacity.lanes, last + 1),
        tick_ns=tick,
        delay_error_ns=max((abs(delay) for delay, _ in errors), default=0.0),
        width_error_ns=max((abs(width) for _, width in errors), default=0.0),
        period_error_ns=abs(period * tick - schedule.period_ns),
        late_ns=tuple(capacity.late_ns(number) for number in range(len(channels))),
    )


def _ticks(value_ns: float, tick_ns: float, name: str) -> int:
    if not math.isfinite(value_ns) or value_ns < 0:
        raise ScheduleError(f"{name} = {value_ns}: must be a time, 0 or more")
    return round(value_ns / tick_ns)


def _pulse(
    pulse: ChannelPulse, channel: int, period_ns: float, period: int, tick: float, late_ns: float
) -> TickPulse:
    _ticks(pulse.delay_ns, tick, f"channel {channel}: delay_ns")  # refuses what is no time
    delay = ticks_of(pulse.delay_ns, late_ns, tick)
    width = _ticks(pulse.width_ns, tick, f"channel {channel}: width_ns")
    if delay >= period:
        raise ScheduleError(
            f"channel {channel}: delay_ns = {pulse.delay_ns} is not within the period of "
            f"{period_ns} ns"
        )
    if not 0 < width < period:
        raise ScheduleError(
            f"channel {channel}: width_ns = {pulse.width_ns} is {width} ticks of {tick:g} ns: must "
            f"be at least one tick and less than the period"
        )
    return TickPulse(delay, width)


def _check_limits(
    channel: int, pulses: Sequence[TickPulse], period: int, capacity: Capacity
) -> None:
    """Compare a channel with its limits as the board's limiter does."""
    limit = capacity.limits[channel]
    tick = capacity.tick_ns
    for run in _runs(pulses, period):
        if run > limit.on_ticks:
            raise ScheduleError(
                f"channel {channel}: on for {run * tick:g} ns, the LED bears "
                f"{limit.on_ticks * tick:g} ns at a time: the board would cut it"
            )
    on = sum(pulse.width for pulse in pulses)
    if limit.duty_divisor == 1:
        return
    if on * limit.duty_divisor > period:
        raise ScheduleError(
            f"channel {channel}: on for {on * tick:g} of {period * tick:g} ns, the LED bears one "
            f"part in {limit.duty_divisor}: the board would hold pulses back"
        )
    # the board adds up whole clocks, and allows for what a stretch that begins and ends within
    # clocks can have beyond them
    allowance = 2 * (capacity.lanes - 1) / limit.duty_divisor
    worst = max(
        (
            sum(_within(p, start, length, period) for p in pulses) - length / limit.duty_divisor
            for start in (pulse.delay for pulse in pulses)
            for length in _stretches(pulses, start, period)
        ),
        default=0.0,
    )
    if worst > limit.burst_ticks - allowance:
        raise ScheduleError(
            f"channel {channel}: pulses so close together that the LED is on for "
            f"{worst * tick:g} ns more than one part in {limit.duty_divisor}; it bears "
            f"{(limit.burst_ticks - allowance) * tick:g} ns: move them apart"
        )


def _stretches(pulses: Sequence[TickPulse], start: int, period: int) -> list[int]:
    """Lengths from a pulse's beginning to every pulse's end, within a period."""
    return [(pulse.delay - start) % period + pulse.width for pulse in pulses]


def _within(pulse: TickPulse, start: int, length: int, period: int) -> int:
    """Ticks of a pulse in a stretch that begins at `start`."""
    offset = (pulse.delay - start) % period
    return max(0, min(length, offset + pulse.width) - offset)


def _runs(pulses: Sequence[TickPulse], period: int) -> list[int]:
    """Lengths of the times on, touching and overlapping pulses joined, on the circle."""
    if not pulses:
        return []
    ordered = sorted(pulses, key=lambda pulse: pulse.delay)
    spans = [(p.delay + turn * period, p.delay + p.width + turn * period)
             for turn in range(3) for p in ordered]  # fmt: skip
    runs = [list(spans[0])]
    for begin, end in spans[1:]:
        if begin <= runs[-1][1]:
            runs[-1][1] = max(runs[-1][1], end)
        else:
            runs.append([begin, end])
    return [end - begin for begin, end in runs]


def _check_apart(channels: Sequence[Sequence[TickPulse]], period: int, tick: float) -> None:
    edges = sorted(
        (pulse.delay, pulse.delay + pulse.width, number)
        for number, pulses in enumerate(channels)
        for pulse in pulses
    )
    around = [*edges, *((begin + period, end + period, n) for begin, end, n in edges[:1])]
    for (begin, end, number), (following, _, other) in pairwise(around):
        if following < end:
            raise ScheduleError(
                f"channels {number} and {other}: the pulses at {begin * tick:g} and "
                f"{following % period * tick:g} ns coincide; if that is meant, ask for overlap"
            )
