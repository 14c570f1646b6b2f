# SPDX-License-Identifier: Apache-2.0
"""The illuminator: schedules, triggers and sequencer programs go in, counters come out."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path

from hueflight.devices import clock_choice
from hueflight.devices.board import Board, BoardIdentity
from hueflight.devices.clock_choice import ClockState
from hueflight.devices.errors import DeviceError, DeviceTimeoutError
from hueflight.devices.fine_delays import FineDelays
from hueflight.devices.illuminator_state import (
    IlluminatorFaults,
    IlluminatorState,
    TriggerCounters,
    TriggerPhases,
)
from hueflight.devices.pulse_schedule import (
    Capacity,
    ChannelLimit,
    PulseSchedule,
    ScheduleError,
    TickSchedule,
    to_ticks,
)
from hueflight.devices.sequencer_program import ProgramStep
from hueflight.devices.transports.interface import Transport
from hueflight.devices.transports.replay import RecordingTransport
from hueflight.devices.transports.serial import BAUD, SerialPort, SerialTransport, find_baud
from hueflight_protocol import illuminator_map
from hueflight_protocol.control import MAX_TRANSACTION, MAX_WORDS, write
from hueflight_protocol.illuminator_map import (
    ARM_KEY,
    BANKS,
    BOARD,
    FINE_STEP_FS,
    MAX_FILTER_TICKS,
    MAX_FINE_STEPS,
    Advance,
    Retrigger,
    TriggerSource,
)
from hueflight_protocol.typed_registers import illuminator as registers


class Illuminator:
    """An illuminator over any transport, real or simulated.

    LEDs are off until `arm`, and off again when nobody feeds the watchdog.

    Parameters
    ----------
    transport : Transport
        Carries control messages.
    timeout_s : float
        Longest time to wait for one answer, in seconds.

    Attributes
    ----------
    identity : BoardIdentity
        What the board says it is.
    board : Board
        Its registers.
    capacity : Capacity
        What the board was built for, and how its fine delays are set.

    Raises
    ------
    WrongDeviceError
        If what answers is no illuminator, or was built from another register map.
    """

    def __init__(self, transport: Transport, /, *, timeout_s: float = 0.5) -> None:
        # block writes take their transaction numbers from the upper half, which single requests
        # reach only after many thousands
        self._numbers = cycle(range((MAX_TRANSACTION + 1) // 2, MAX_TRANSACTION + 1))
        # identity, capacity and features are the same in every build; the map needs them first
        largest = illuminator_map(external_clock=True, fine_steps=MAX_FINE_STEPS)
        probe = Board(transport, largest, timeout_s=timeout_s)
        self.identity: BoardIdentity = probe.identify(BOARD)
        size, tick = probe.read_together(registers.Capacity, registers.TickFs)
        features = probe.read(registers.Features)
        external_clock, fine = bool(features.external_clock), None
        if features.fine_delay:
            fine = probe.read(registers.FineStep)
        self.board = Board(
            transport,
            illuminator_map(
                channels=size.channels,
                pulses=size.pulses,
                steps=size.steps,
                lanes=size.lanes,
                tick_fs=tick.value,
                clock_hz=self.identity.clock_hz,
                external_clock=external_clock,
                fine_steps=0 if fine is None else fine.steps,
                fine_step_fs=FINE_STEP_FS if fine is None else fine.step_fs,
            ),
            timeout_s=timeout_s,
        )
        self.board.check_map()
        limits = tuple(
            ChannelLimit(**self.board.read(registers.Limit, channel).as_dict())
            for channel in range(size.channels)
        )
        delays = None
        if fine is not None:
            settings = self.board.read_elements(registers.FineDelay)
            delays = FineDelays(fine.steps, fine.step_fs / 1e6, settings, (0.0,) * size.channels)
        self.capacity = Capacity(
            size.channels, size.pulses, size.steps, size.lanes, tick.value * 1e-6, limits, delays
        )

    # -- arming -------------------------------------------------------------------------------

    def arm(self, *, watchdog_ms: int = 1000) -> None:
        """Let LEDs fire, for as long as `feed` is called in time.

        Parameters
        ----------
        watchdog_ms : int
            Time without a feed after which the board disarms itself, in milliseconds.

        Raises
        ------
        ScheduleError
            If the time is out of the range that the board has.
        """
        longest = registers.WatchdogMs.VALUE_MAX
        if not 1 <= watchdog_ms <= longest:
            raise ScheduleError(f"watchdog_ms = {watchdog_ms}: must be from 1 to {longest}")
        self.board.write(registers.WatchdogMs(watchdog_ms))
        self.board.write(registers.Arm(ARM_KEY))

    def disarm(self) -> None:
        """Turn LEDs off at once."""
        self.board.write(registers.Arm(0))

    def check_disarmed(self) -> None:
        """Refuse a board that is armed.

        Raises
        ------
        DeviceError
            If it is.
        """
        if self.state().armed:
            raise DeviceError(
                f"the illuminator at {self.identity.place} is armed: another program may use it; "
                "disarm it first"
            )

    def feed(self) -> None:
        """Start the watchdog's time again; it does not arm."""
        self.board.write(registers.WatchdogFeed(1))

    # -- schedules ----------------------------------------------------------------------------

    def load(self, schedule: PulseSchedule, /, *, bank: int) -> TickSchedule:
        """Write a schedule into a bank that is not in use.

        Parameters
        ----------
        schedule : PulseSchedule
            Pulses of every channel.
        bank : int
            Schedule bank, 0 or 1.

        Returns
        -------
        TickSchedule
            What the board will play, with the errors of rounding.

        Raises
        ------
        ScheduleError
            If the board can't or must not play it; nothing was written.
        RequestError
            If the bank is in use.
        """
        if not 0 <= bank < BANKS:
            raise ScheduleError(f"bank = {bank}: must be 0 or 1")
        made = to_ticks(schedule, self.capacity)
        self.board.write(registers.BankPeriod(made.busy), bank)
        self.board.write(registers.BankEnable((1 << len(made.channels)) - 1), bank)
        declared = self.board.registers[registers.Pulse.NAME]
        words: dict[int, int] = {}
        for channel in range(self.capacity.channels):
            pulses = made.channels[channel] if channel < len(made.channels) else ()
            for number in range(self.capacity.pulses):
                word = 0
                if number < len(pulses):
                    pulse = pulses[number]
                    value = registers.Pulse(delay=pulse.delay, width=pulse.width)
                    word = value.encode(declared)
                words[declared.address_of(bank, channel, number)] = word
        self._write_words(words)
        return made

    def select(self, bank: int, /) -> None:
        """Have the next train play a bank; a program that is running has precedence.

        Parameters
        ----------
        bank : int
            Schedule bank, 0 or 1.
        """
        self.board.write(registers.BankSelect(bank))

    def play(self, schedule: PulseSchedule, /) -> TickSchedule:
        """Load a schedule into the bank that is not in use, and have the next train play it.

        Parameters
        ----------
        schedule : PulseSchedule
            Pulses of every channel.

        Returns
        -------
        TickSchedule
            What the board will play, with the errors of rounding.
        """
        bank = 1 - self.board.read(registers.BankSelect).value
        made = self.load(schedule, bank=bank)
        self.select(bank)
        return made

    def align(
        self,
        schedule: PulseSchedule,
        /,
        *,
        skew_ns: Sequence[float] | None = None,
        step_ns: float | None = None,
    ) -> FineDelays:
        """Set the fine delays of channels so that a schedule comes out as exactly as it can.

        The schedule itself is left to `load` or `play`, which count with the fine delays and
        return the errors that are left. Fine delays belong to channels, not to banks. They stay
        until they are set again; the skew is kept by this object, not by the board.

        Parameters
        ----------
        schedule : PulseSchedule
            Pulses of every channel.
        skew_ns : sequence of float, optional
            How much later each channel fires than another one, in nanoseconds, as measured at
            equal settings; by default as it was given before, 0 at first.
        step_ns : float, optional
            Step of the lines if it was measured, in nanoseconds; by default as it was given
            before, at first the nominal one.

        Returns
        -------
        FineDelays
            The settings, and the time by which all channels fire later than asked.

        Raises
        ------
        ScheduleError
            If the board has no fine delay lines, or the schedule has too many channels.
        FineDelayError
            If skew or step are no times.
        RequestError
            If the board is armed.
        """
        lines = self.fine_delays()
        if skew_ns is not None:
            lines = replace(lines, skew_ns=tuple(skew_ns))
        if step_ns is not None:
            lines = replace(lines, step_ns=step_ns)
        delays = [[pulse.delay_ns for pulse in pulses] for pulses in schedule.channels]
        lines = lines.fitted(delays, self.capacity.tick_ns)
        to_ticks(schedule, replace(self.capacity, fine=lines))  # refuses before it writes
        self.set_fine_delays(lines)
        return lines

    def set_fine_delays(self, lines: FineDelays, /) -> None:
        """Set the fine delay lines, as `align` does for a schedule.

        Parameters
        ----------
        lines : FineDelays
            The settings; step and skew are what `load` and `play` count with from now on.

        Raises
        ------
        ScheduleError
            If the board has no such lines.
        RequestError
            If the board is armed.
        """
        own = self.fine_delays()
        if (lines.steps, len(lines.settings)) != (own.steps, len(own.settings)):
            raise ScheduleError(
                f"{len(lines.settings)} lines of {lines.steps} settings: the board at "
                f"{self.identity.place} has {len(own.settings)} of {own.steps}"
            )
        declared = self.board.registers[registers.FineDelay.NAME]
        self._write_words(
            {declared.address_of(channel): value for channel, value in enumerate(lines.settings)}
        )
        self.capacity = replace(self.capacity, fine=lines)

    def fine_delays(self) -> FineDelays:
        """Return how the fine delay lines are set.

        Returns
        -------
        FineDelays
            The settings, and step and skew as far as they were given.

        Raises
        ------
        ScheduleError
            If the board has no fine delay lines.
        """
        if self.capacity.fine is None:
            raise ScheduleError(
                f"the board at {self.identity.place} was built without fine delay lines: build it "
                "with --set fine_delay=1"
            )
        return self.capacity.fine

    # -- triggers -----------------------------------------------------------------------------

    def set_trigger(
        self,
        source: TriggerSource,
        /,
        *,
        period_ns: float | None = None,
        restart: bool = False,
        falling: bool = False,
        output: bool = False,
        filter_ns: float | None = None,
    ) -> float:
        """Choose what starts a train.

        Parameters
        ----------
        source : TriggerSource
            External input, internal period, or `trigger_now`.
        period_ns : float, optional
            Period of the internal trigger, by default unchanged.
        restart : bool
            True if a trigger during a train starts a new one; otherwise it is ignored.
        falling : bool
            True if the falling edge of the external trigger counts.
        output : bool
            True to send a trigger-out with every train.
        filter_ns : float, optional
            Time for which the external trigger must keep its level before and after an edge that
            counts, rounded up to ticks; 0 for no filter, by default unchanged. With a filter all
            trains start a few clocks later (see *Glitches of the trigger* in
            ``docs/illuminator.md``).

        Returns
        -------
        float
            The internal period that the board makes, in nanoseconds.

        Raises
        ------
        ScheduleError
            If the board can't make the period or the filter.
        """
        if filter_ns is not None:
            self.board.write(registers.TriggerFilter(self._filter_ticks(filter_ns)))
        if period_ns is not None:
            self.board.write(registers.TriggerPeriod(self._trigger_ticks(period_ns)))
        self.board.write(
            registers.Trigger(
                source=source,
                retrigger=Retrigger.RESTART if restart else Retrigger.IGNORE,
                falling=int(falling),
                output=int(output),
            )
        )
        return self.board.read(registers.TriggerPeriod).value * self.capacity.tick_ns

    def set_trigger_out(self, delay_ns: float, width_ns: float, /) -> None:
        """Place the trigger-out for a camera that follows, relative to the trigger.

        Parameters
        ----------
        delay_ns, width_ns : float
            Delay after the trigger and width of the pulse, in nanoseconds.

        Raises
        ------
        ScheduleError
            If the board can't make one of them.
        """
        tick = self.capacity.tick_ns
        delay, width = round(delay_ns / tick), round(width_ns / tick)
        for name, ticks, most in (
            ("delay_ns", delay, registers.TriggerOut.DELAY_MAX),
            ("width_ns", width, registers.TriggerOut.WIDTH_MAX),
        ):
            if not 0 <= ticks <= most:
                raise ScheduleError(f"{name}: must be from 0 to {most * tick:g} ns")
        self.board.write(registers.TriggerOut(delay=delay, width=width))

    def trigger_now(self) -> None:
        """Start one train; the trigger source must be software."""
        self.board.write(registers.TriggerNow(1))

    # -- sequencer programs -------------------------------------------------------------------

    def run(
        self,
        program: Sequence[ProgramStep],
        /,
        *,
        advance: Advance = Advance.TRIGGERS,
        loop: bool = False,
    ) -> None:
        """Write a sequencer program and start it; one that is running is stopped.

        Parameters
        ----------
        program : sequence of ProgramStep
            Steps of the program.
        advance : Advance
            What the steps count: trains, or frame syncs from the camera, of which the first
            starts the program.
        loop : bool
            True to begin again after the last step, until `stop`.

        Raises
        ------
        ScheduleError
            If there are no steps or too many, or the board can't do one.
        DeviceTimeoutError
            If the program that is running does not stop.
        """
        if not 1 <= len(program) <= self.capacity.steps:
            raise ScheduleError(
                f"a program of {len(program)} steps: the board takes 1 to {self.capacity.steps}"
            )
        words = [word for number, step in enumerate(program) for word in self._step(number, step)]
        self.stop()
        self._write_words(dict(enumerate(words, registers.StepSetup.ADDRESS)))
        self.board.write(registers.Sequencer(advance=advance, loop=int(loop), length=len(program)))
        self.board.write(registers.SequencerControl(start=1))

    def stop(self, *, timeout_s: float = 0.5) -> None:
        """End the program, if one is running; the selected bank plays with the next train.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait for the end, in seconds.

        Raises
        ------
        DeviceTimeoutError
            If the program does not stop in time.
        """
        self.board.write(registers.SequencerControl(stop=1))
        deadline = time.monotonic() + timeout_s
        while self.state().sequencing:
            if time.monotonic() > deadline:
                raise DeviceTimeoutError(
                    f"the program of {self.identity.place} did not stop within {timeout_s} s"
                )

    def frame_sync(self) -> None:
        """Do what the camera's frame sync does."""
        self.board.write(registers.SequencerControl(sync=1))

    # -- the clock ----------------------------------------------------------------------------

    def clock(self) -> ClockState:
        """Read which clock the board runs from.

        Returns
        -------
        ClockState
            The clock in use, and whether there is an external one.
        """
        return clock_choice.read_clock(self.board)

    def choose_clock(
        self, source: clock_choice.ClockName, /, *, timeout_s: float = 0.5
    ) -> ClockState:
        """Run from the board's oscillator or from an external clock.

        A change disarms the board and stops its clocks for some milliseconds; LEDs are off.
        Afterwards the fault ``clock_failed``, which such a change sets, is cleared.

        Parameters
        ----------
        source : {"internal", "external"}
            The clock.
        timeout_s : float
            Longest time for the change, in seconds.

        Returns
        -------
        ClockState
            State after the change.

        Raises
        ------
        DeviceError
            If the board has no external clock, none of the right frequency is there, or it fails
            during the change.
        """
        fault = registers.Faults(clock_failed=1)
        return clock_choice.choose_clock(self.board, source, fault, timeout_s=timeout_s)

    # -- what the board reports ---------------------------------------------------------------

    def state(self) -> IlluminatorState:
        """Read what the board is doing.

        Returns
        -------
        IlluminatorState
            The state.
        """
        found = self.board.read(registers.State)
        return IlluminatorState(
            armed=bool(found.armed),
            busy=bool(found.busy),
            bank=found.bank,
            swap_pending=bool(found.swap_pending),
            sequencing=bool(found.sequencing),
            step=found.step,
            marker=found.marker,
        )

    def counters(self) -> TriggerCounters:
        """Read the trigger counters, all of the same clock.

        Returns
        -------
        TriggerCounters
            Triggers since the counters were cleared.
        """
        counts = self.board.read_together(
            registers.TriggersSeen,
            registers.TriggersServed,
            registers.TriggersIgnored,
            registers.Restarts,
            registers.Swaps,
        )
        return TriggerCounters(*(count.value for count in counts))

    def phases(self) -> TriggerPhases:
        """Read where within the clock external triggers fell.

        Returns
        -------
        TriggerPhases
            Phases since the statistics were cleared.
        """
        found = self.board.read(registers.Phase)
        counts = self.board.read_elements(registers.PhaseCount)
        if not found.valid:
            return TriggerPhases(None, None, None, counts)
        return TriggerPhases(found.last, found.min, found.max, counts)

    def faults(self) -> IlluminatorFaults:
        """Read what went wrong since the faults were cleared.

        Returns
        -------
        IlluminatorFaults
            The faults.
        """
        found = self.board.read(registers.Faults)
        on, duty = self.board.read(registers.OnLimited), self.board.read(registers.DutyLimited)
        return IlluminatorFaults(
            watchdog=bool(found.watchdog),
            on_limited=self._channels(on.value),
            duty_limited=self._channels(duty.value),
            trigger_ignored=bool(found.trigger_ignored),
            saturated=bool(found.saturated),
            clock_failed=bool(found.clock_failed),
            reference_lost=bool(found.reference_lost),
            clock_failures=self.board.read(registers.ClockFailures).value,
        )

    def clear(self) -> None:
        """Clear counters, phases and faults."""
        every = (1 << self.capacity.channels) - 1
        self.board.write(registers.Clear(counters=1, phase=1))
        self.board.write(registers.OnLimited(every))
        self.board.write(registers.DutyLimited(every))
        faults = self.board.registers[registers.Faults.NAME]  # of this build
        self._write_words({faults.address: faults.encode(**dict.fromkeys(faults.fields, 1))})

    def close(self) -> None:
        """Turn LEDs off and release the line."""
        try:
            self.disarm()
        finally:
            self.board.close()

    def _trigger_ticks(self, period_ns: float) -> int:
        tick = self.capacity.tick_ns
        ticks = round(period_ns / tick)
        shortest, longest = self.capacity.min_period_ticks, registers.TriggerPeriod.VALUE_MAX
        if not shortest <= ticks <= longest:
            raise ScheduleError(
                f"period_ns = {period_ns}: must be from {shortest * tick:g} to {longest * tick:g} "
                "ns"
            )
        return ticks

    def _filter_ticks(self, filter_ns: float) -> int:
        tick = self.capacity.tick_ns
        ticks = math.ceil(filter_ns / tick - 1e-9) if filter_ns >= 0 else -1
        if not 0 <= ticks <= MAX_FILTER_TICKS:
            raise ScheduleError(
                f"filter_ns = {filter_ns}: must be from 0 to {MAX_FILTER_TICKS * tick:g} ns"
            )
        return ticks

    def _step(self, number: int, step: ProgramStep) -> tuple[int, int, int, int]:
        """Return the words of a step: setup, channels, count and idle time."""
        channels = range(self.capacity.channels) if step.channels is None else step.channels
        for name, value, high in (
            ("count", step.count, registers.StepCount.VALUE_MAX),
            ("idle", step.idle, registers.StepIdle.VALUE_MAX),
            ("marker", step.marker, registers.StepSetup.MARKER_MAX),
            ("bank", step.bank, registers.StepSetup.BANK_MAX),
            *(("channel", channel, self.capacity.channels - 1) for channel in channels),
        ):
            if not 0 <= value <= high:
                raise ScheduleError(f"step {number}: {name} = {value} is not from 0 to {high}")
        setup = registers.StepSetup(bank=step.bank, marker=step.marker)
        word = setup.encode(self.board.registers[setup.NAME])
        return word, sum(1 << channel for channel in channels), step.count, step.idle

    def _channels(self, bits: int) -> frozenset[int]:
        """Return the channels whose bits are set."""
        return frozenset(
            channel for channel in range(self.capacity.channels) if bits >> channel & 1
        )

    def _write_words(self, words: Mapping[int, int]) -> None:
        """Write words by address, consecutive ones in one request."""
        places = sorted(words)
        while places:
            count = 1
            while count < min(len(places), MAX_WORDS) and places[count] == places[0] + count:
                count += 1
            part, places = places[:count], places[count:]
            request = write(next(self._numbers), part[0], [words[place] for place in part])
            self.board.request(request, repeat=True)


def open_illuminator(
    path: str, /, *, baud: int | None = None, record: Path | None = None
) -> Illuminator:
    """Open the illuminator on a serial port.

    Parameters
    ----------
    path : str
        Serial port, such as ``/dev/ttyUSB0``.
    baud : int, optional
        Line rate in bits per second; by default it is found, see `find_baud`.
    record : Path, optional
        File for the transactions with the board, see `transports.replay`.

    Returns
    -------
    Illuminator
        The board, LEDs off.

    Raises
    ------
    DeviceError
        If the port can't be opened, or what answers there is no illuminator.
    OSError
        If the file can't be written.
    """
    line = SerialPort(path, baud=BAUD if baud is None else baud)
    transport: Transport = SerialTransport(line)
    try:
        if baud is None:
            find_baud(line)
        if record is not None:
            transport = RecordingTransport(transport, record)
        return Illuminator(transport)
    except BaseException:
        transport.close()
        raise
