# SPDX-License-Identifier: Apache-2.0
"""Tests of an illuminator on the bench, with bounds, through its driver alone."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from itertools import count

from hueflight.devices.errors import DeviceError
from hueflight.devices.illuminator import Illuminator
from hueflight.devices.pulse_schedule import ChannelPulse, PulseSchedule
from hueflight.devices.selftest import WORDS, SelfTestResult, Tell, line_test, temperature_test
from hueflight.devices.skew import PERIOD_TICKS, WIDTH_TICKS
from hueflight_protocol.illuminator_map import TriggerSource
from hueflight_protocol.typed_registers import illuminator as registers

TRAINS = 20
"""Trains after which the walk goes on to the next LED, at least."""
ON_NS = 10.0
"""Longest on-time of an LED in a train, unless a tick is longer."""
_TRAIN_TICKS = 1024
_WATCHDOG_MS = 1000
_SHORT_WATCHDOG_MS = 5
_POLLS = 400
"""Questions after which nothing that has not happened is waited for any longer."""


def run_illuminator_selftest(
    board: Illuminator,
    /,
    *,
    leds: bool = True,
    loop: bool = False,
    words: int = WORDS,
    dwell_s: float = 0.0,
    tell: Tell = lambda result: None,
) -> tuple[SelfTestResult, ...]:
    """Test an illuminator: clock, line, temperature, LEDs one after another, and watchdog.

    LEDs fire for at most 10 ns, or one tick if that is longer, in each of the longest internal
    periods of the board (82 µs on ECP5, a duty of 0.012 %). Afterwards the board is disarmed, waits
    for external triggers, and has the schedule of the last LED.

    Parameters
    ----------
    board : Illuminator
        The board; it must not be armed.
    leds : bool
        False to leave LEDs off: neither the walk nor the watchdog is tested.
    loop : bool
        True if a wire leads the trigger output to the trigger input, which is tested then.
    words : int
        Words that are written and read again on the line.
    dwell_s : float
        Shortest time for which each LED fires, in seconds.
    tell : callable
        Called with each result.

    Returns
    -------
    tuple of SelfTestResult
        Results, in the order of the tests.

    Raises
    ------
    DeviceError
        If the board is armed, which another program may have done, or does not answer.
    """
    board.check_disarmed()
    board.clear()
    results = []
    try:
        for result in _tests(board, leds, loop, words, dwell_s):
            tell(result)
            results.append(result)
    except BaseException:
        with contextlib.suppress(DeviceError):  # the first error says more
            _leave(board)
        raise
    _leave(board)
    return tuple(results)


def _leave(board: Illuminator) -> None:
    """Disarm the board, and let it wait for external triggers."""
    board.disarm()
    board.set_trigger(TriggerSource.EXTERNAL)
    board.clear()


def _tests(
    board: Illuminator, leds: bool, loop: bool, words: int, dwell_s: float
) -> Iterator[SelfTestResult]:
    yield _clock(board)
    yield line_test(board.board, words)
    if board.board.read(registers.Features).temperature:
        yield temperature_test(board.board)
    if loop:
        yield _loop(board, dwell_s)
    if leds:
        for channel in range(board.capacity.channels):
            yield _led(board, channel, dwell_s)
        yield _watchdog(board)


def _clock(board: Illuminator) -> SelfTestResult:
    """Test that the board's clock has not failed since it was configured."""
    failures = board.faults().clock_failures
    return SelfTestResult(
        "clock", failures == 0, f"{failures} failures", "none since configuration"
    )


def _loop(board: Illuminator, dwell_s: float) -> SelfTestResult:
    """Test that each trigger from the output comes back and starts the next train, LEDs off."""
    tick = board.capacity.tick_ns
    filtered, output = (
        board.board.read(registers.TriggerFilter),
        board.board.read(registers.TriggerOut),
    )
    period = PERIOD_TICKS * tick
    board.disarm()
    board.play(PulseSchedule(((),) * board.capacity.channels, period_ns=period))
    try:
        # as for the skew: one pulse is always on its way when the source changes to the wire
        board.set_trigger_out(period - 2 * board.capacity.lanes * tick, WIDTH_TICKS * tick)
        board.set_trigger(TriggerSource.INTERNAL, period_ns=period, output=True)
        board.set_trigger(TriggerSource.EXTERNAL, output=True, filter_ns=0)
        board.state()  # long enough for the second pulse to be ignored
        board.clear()
        until = time.monotonic() + dwell_s
        found = board.counters()
        polls = 1
        while (found.served < TRAINS and polls < _POLLS) or time.monotonic() < until:
            found = board.counters()
            polls += 1
        goes_on = board.counters().served > found.served
    finally:
        board.set_trigger(TriggerSource.EXTERNAL)
        board.board.write(filtered)
        board.board.write(output)
    return SelfTestResult(
        "trigger loop",
        goes_on and found.served >= TRAINS and not found.ignored,
        f"{found.served} turns, {found.ignored} triggers ignored" + ("" if goes_on else ", ended"),
        f"at least {TRAINS} turns and going on, none ignored",
    )


def _led(board: Illuminator, channel: int, dwell_s: float) -> SelfTestResult:
    """Test that one LED fires as often as it is triggered, and that no limit holds it back."""
    tick = board.capacity.tick_ns
    width = max(1, int(ON_NS / tick)) * tick
    pulses: list[tuple[ChannelPulse, ...]] = [()] * board.capacity.channels
    pulses[channel] = (ChannelPulse(0.0, width),)
    period = registers.TriggerPeriod.VALUE_MAX * tick
    board.disarm()
    board.set_trigger(TriggerSource.SOFTWARE)
    board.play(PulseSchedule(tuple(pulses), period_ns=_TRAIN_TICKS * tick))
    board.clear()
    board.arm(watchdog_ms=_WATCHDOG_MS)
    board.set_trigger(TriggerSource.INTERNAL, period_ns=period)
    until = time.monotonic() + dwell_s
    for polls in count(1):
        board.feed()
        fired = board.counters().served >= TRAINS
        if (fired or polls >= _POLLS) and time.monotonic() >= until:
            break
    armed = board.state().armed
    board.disarm()
    counters, faults = board.counters(), board.faults()
    limited = faults.on_limited | faults.duty_limited
    return SelfTestResult(
        f"LED {channel}",
        armed
        and counters.served >= TRAINS
        and not counters.ignored
        and not limited
        and not faults.clock_failed,
        f"{counters.served} trains, {counters.ignored} triggers ignored"
        + (", limited" if limited else "")
        + ("" if armed else ", disarmed"),
        f"at least {TRAINS} trains, none ignored, no limit reached",
    )


def _watchdog(board: Illuminator) -> SelfTestResult:
    """Test that a board that is not fed disarms itself and says so."""
    board.clear()
    board.arm(watchdog_ms=_SHORT_WATCHDOG_MS)
    began = time.monotonic()
    for _ in range(_POLLS):
        if not board.state().armed:
            break
    elapsed = time.monotonic() - began
    disarmed, told = not board.state().armed, board.faults().watchdog
    return SelfTestResult(
        "watchdog",
        disarmed and told,
        f"disarmed after {1000 * elapsed:.0f} ms by the computer's clock" if disarmed else "armed",
        f"disarms, and reports it, after {_SHORT_WATCHDOG_MS} ms without being fed",
    )
