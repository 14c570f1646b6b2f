"""The illuminator: schedules, triggers and programs in; counters and phases out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle

from hueflight.devices.board import Board, BoardIdentity
from hueflight.devices.errors import DeviceError, DeviceTimeoutError
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
from hueflight.devices.transports.serial import BAUD, SerialPort, SerialTransport
from hueflight_protocol import illuminator_map
from hueflight_protocol.control import MAX_WORDS, write
from hueflight_protocol.illuminator_map import (
    ARM_KEY,
    BANKS,
    BOARD,
    Advance,
    Retrigger,
    TriggerSource,
)

_CAPACITY_ADDRESS, _CAPACITY_WORDS = 0x010, 2


@dataclass(frozen=True)
class IlluminatorState:
    """What the board is doing.

    Attributes
    ----------
    armed : LEDs may fire.
    busy : a train is running.
    bank : schedule of the last train.
    swap_pending : another one is selected and waits for the next train.
    sequencing : a program is running.
    step, marker : of the program; marker on the outputs.
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
    """Triggers since the counters were cleared; each stops at 2^32 - 1.

    Attributes
    ----------
    seen, served, ignored : edges; those that began a train; those that did not.
    restarts : trains cut by the next one.
    swaps : changes of schedule.
    """

    seen: int
    served: int
    ignored: int
    restarts: int
    swaps: int


@dataclass(frozen=True)
class TriggerPhases:
    """Where in the board's clock served external triggers fell, in ticks.

    Attributes
    ----------
    last, smallest, largest : None if there was none since cleared.
    counts : of each phase.
    """

    last: int | None
    smallest: int | None
    largest: int | None
    counts: tuple[int, ...]


@dataclass(frozen=True)
class IlluminatorFaults:
    """What went wrong since last cleared.

    Attributes
    ----------
    watchdog : the board disarmed itself.
    on_limited, duty_limited : channels that were cut.
    trigger_ignored : a trigger came while a train was running.
    saturated : a counter stands at its largest value.
    """

    watchdog: bool
    on_limited: frozenset[int]
    duty_limited: frozenset[int]
    trigger_ignored: bool
    saturated: bool


class Illuminator:
    """An illuminator over any transport, real or simulated.

    LEDs are dark until `arm`, and dark again when nobody feeds the watchdog.

    Parameters
    ----------
    transport : for control messages.
    timeout_s : longest wait for one answer.

    Raises
    ------
    WrongDeviceError
        If what answers is no illuminator, or was built from another register map.
    """

    def __init__(self, transport: Transport, /, *, timeout_s: float = 0.5) -> None:
        # block writes count their transactions in the half that single ones begin far from
        self._numbers = cycle(range(0x8000, 0x10000))
        # identity and capacity are the same in every build; the map needs the capacity first
        probe = Board(transport, illuminator_map(), timeout_s=timeout_s)
        self.identity: BoardIdentity = probe.identify(BOARD)
        size, tick_fs = probe.read_words(_CAPACITY_ADDRESS, _CAPACITY_WORDS)
        channels, pulses = size & 0xFF, size >> 8 & 0xFF
        steps, lanes = size >> 16 & 0xFF, size >> 24
        self.board = Board(
            transport,
            illuminator_map(
                channels=channels,
                pulses=pulses,
                steps=steps,
                lanes=lanes,
                tick_fs=tick_fs,
                clock_hz=self.identity.clock_hz,
            ),
            timeout_s=timeout_s,
        )
        self.board.check_map()
        limits = tuple(
            ChannelLimit(**self.board.fields("limit", channel)) for channel in range(channels)
        )
        self.capacity = Capacity(channels, pulses, steps, lanes, tick_fs * 1e-6, limits)

    # -- arming -------------------------------------------------------------------------------

    def arm(self, *, watchdog_ms: int = 1000) -> None:
        """Let LEDs fire, for as long as `feed` is called in time.

        Parameters
        ----------
        watchdog_ms : time without a feed after which the board disarms itself.

        Raises
        ------
        ScheduleError
            If the time is not 1 to 65535 ms.
        """
        if not 1 <= watchdog_ms <= 65535:
            raise ScheduleError(f"watchdog_ms = {watchdog_ms}: must be from 1 to 65535")
        self.board.write("watchdog_ms", value=watchdog_ms)
        self.board.write("arm", value=ARM_KEY)

    def disarm(self) -> None:
        """Make LEDs dark at once."""
        self.board.write("arm", value=0)

    def feed(self) -> None:
        """Start the watchdog's time again; it does not arm."""
        self.board.write("watchdog_feed", value=1)

    # -- schedules ----------------------------------------------------------------------------

    def load(self, schedule: PulseSchedule, /, *, bank: int) -> TickSchedule:
        """Write a schedule into a bank that is not in use.

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
        self.board.write("bank_period", bank, value=made.busy)
        self.board.write("bank_enable", bank, value=(1 << len(made.channels)) - 1)
        register = self.board.registers["pulse"]
        words: dict[int, int] = {}
        for channel in range(self.capacity.channels):
            pulses = made.channels[channel] if channel < len(made.channels) else ()
            for number in range(self.capacity.pulses):
                word = 0
                if number < len(pulses):
                    pulse = pulses[number]
                    word = register.encode(delay=pulse.delay, width=pulse.width)
                words[register.address_of(bank, channel, number)] = word
        self._write_words(words)
        return made

    def select(self, bank: int, /) -> None:
        """Have the next train play a bank; a running program has precedence."""
        self.board.write("bank_select", value=bank)

    def play(self, schedule: PulseSchedule, /) -> TickSchedule:
        """Load a schedule into the bank that is not in use, and have the next train play it."""
        bank = 1 - self.board.fields("bank_select")["value"]
        made = self.load(schedule, bank=bank)
        self.select(bank)
        return made

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
    ) -> float:
        """Choose what starts a train.

        Parameters
        ----------
        source : external input, internal period, or `trigger_now`.
        period_ns : of the internal trigger; as it was, if not given.
        restart : a trigger during a train begins a new one, rather than being ignored.
        falling : the external trigger's falling edge counts.
        output : send a trigger-out with every train.

        Returns
        -------
        float
            The internal period as it is made, in nanoseconds.
        """
        if period_ns is not None:
            self.board.write("trigger_period", value=self._trigger_ticks(period_ns))
        self.board.write(
            "trigger",
            source=source,
            retrigger=Retrigger.RESTART if restart else Retrigger.IGNORE,
            falling=int(falling),
            output=int(output),
        )
        return self.board.read("trigger_period") * self.capacity.tick_ns

    def set_trigger_out(self, delay_ns: float, width_ns: float, /) -> None:
        """Place the trigger-out for a camera that follows, relative to the trigger."""
        tick = self.capacity.tick_ns
        delay, width = round(delay_ns / tick), round(width_ns / tick)
        for name, ticks in (("delay_ns", delay), ("width_ns", width)):
            if not 0 <= ticks <= 4095:
                raise ScheduleError(f"{name}: must be from 0 to {4095 * tick:g} ns")
        self.board.write("trigger_out", delay=delay, width=width)

    def trigger_now(self) -> None:
        """Start one train; the source must be software."""
        self.board.write("trigger_now", value=1)

    # -- programs -----------------------------------------------------------------------------

    def run(
        self,
        program: Sequence[ProgramStep],
        /,
        *,
        advance: Advance = Advance.TRIGGERS,
        loop: bool = False,
    ) -> None:
        """Write a program and begin it; one that runs is stopped.

        Parameters
        ----------
        program : steps.
        advance : what units are: trains, or frame syncs from the camera, of which the first
            begins the program.
        loop : begin again after the last step, until `stop`.

        Raises
        ------
        ScheduleError
            If there are no steps, too many, or a step can't be.
        DeviceTimeoutError
            If the program that runs does not stop.
        """
        registers = self.board.registers
        if not 1 <= len(program) <= self.capacity.steps:
            raise ScheduleError(
                f"a program of {len(program)} steps: the board takes 1 to {self.capacity.steps}"
            )
        words = [word for number, step in enumerate(program) for word in self._step(number, step)]
        first = registers["step_setup"].address
        self.stop()
        self._write_words(dict(enumerate(words, first)))
        self.board.write("sequencer", advance=advance, loop=int(loop), length=len(program))
        self.board.write("sequencer_control", start=1)

    def stop(self, *, timeout_s: float = 0.5) -> None:
        """End the program, if one runs; the manual schedule is back with the next train."""
        self.board.write("sequencer_control", stop=1)
        deadline = time.monotonic() + timeout_s
        while self.state().sequencing:
            if time.monotonic() > deadline:
                raise DeviceTimeoutError(
                    f"the program of {self.identity.place} did not stop within {timeout_s} s"
                )

    def frame_sync(self) -> None:
        """Do what the camera's frame sync does."""
        self.board.write("sequencer_control", sync=1)

    # -- what the board says ------------------------------------------------------------------

    def state(self) -> IlluminatorState:
        """What the board is doing."""
        found = self.board.fields("state")
        return IlluminatorState(
            armed=bool(found["armed"]),
            busy=bool(found["busy"]),
            bank=found["bank"],
            swap_pending=bool(found["swap_pending"]),
            sequencing=bool(found["sequencing"]),
            step=found["step"],
            marker=found["marker"],
        )

    def counters(self) -> TriggerCounters:
        """Triggers since cleared, all counted up to the same clock."""
        first = self.board.registers["triggers_seen"].address
        return TriggerCounters(*self.board.read_words(first, 5))

    def phases(self) -> TriggerPhases:
        """Where in the clock external triggers fell."""
        found = self.board.fields("phase")
        lanes = self.capacity.lanes
        counts = self.board.read_words(self.board.registers["phase_count"].address, lanes)
        if not found["valid"]:
            return TriggerPhases(None, None, None, counts)
        return TriggerPhases(found["last"], found["min"], found["max"], counts)

    def faults(self) -> IlluminatorFaults:
        """What went wrong since last cleared."""
        found = self.board.fields("faults")
        on, duty = self.board.read("on_limited"), self.board.read("duty_limited")
        return IlluminatorFaults(
            watchdog=bool(found["watchdog"]),
            on_limited=_channels(on),
            duty_limited=_channels(duty),
            trigger_ignored=bool(found["trigger_ignored"]),
            saturated=bool(found["saturated"]),
        )

    def clear(self) -> None:
        """Set counters, phases and faults to nothing."""
        every = (1 << self.capacity.channels) - 1
        self.board.write("clear", counters=1, phase=1)
        self.board.write("on_limited", value=every)
        self.board.write("duty_limited", value=every)
        faults = self.board.registers["faults"]
        self.board.write("faults", **dict.fromkeys(faults.fields, 1))

    def close(self) -> None:
        """Make LEDs dark and give the line back."""
        try:
            self.disarm()
        finally:
            self.board.close()

    def _trigger_ticks(self, period_ns: float) -> int:
        tick = self.capacity.tick_ns
        ticks = round(period_ns / tick)
        shortest = 8 * self.capacity.lanes
        if not shortest <= ticks <= 0xFFFF:
            raise ScheduleError(
                f"period_ns = {period_ns}: must be from {shortest * tick:g} to {0xFFFF * tick:g} ns"
            )
        return ticks

    def _step(self, number: int, step: ProgramStep) -> tuple[int, int, int, int]:
        channels = range(self.capacity.channels) if step.channels is None else step.channels
        for name, value, high in (
            ("count", step.count, 0xFFFFFFFF),
            ("idle", step.idle, 0xFFFFFFFF),
            ("marker", step.marker, 0xFF),
            ("bank", step.bank, BANKS - 1),
            *(("channel", channel, self.capacity.channels - 1) for channel in channels),
        ):
            if not 0 <= value <= high:
                raise ScheduleError(f"step {number}: {name} = {value} is not from 0 to {high}")
        setup = self.board.registers["step_setup"].encode(bank=step.bank, marker=step.marker)
        return setup, sum(1 << channel for channel in channels), step.count, step.idle

    def _write_words(self, words: Mapping[int, int]) -> None:
        """Write words by address, neighbours together."""
        places = sorted(words)
        while places:
            count = 1
            while count < min(len(places), MAX_WORDS) and places[count] == places[0] + count:
                count += 1
            part, places = places[:count], places[count:]
            request = write(next(self._numbers), part[0], [words[place] for place in part])
            self.board.request(request, repeat=True)


def open_illuminator(path: str, /, *, baud: int = BAUD) -> Illuminator:
    """Open the illuminator on a serial port.

    Raises
    ------
    DeviceError
        If the port can't be opened, or what answers there is no illuminator.
    """
    line = SerialPort(path, baud=baud)
    try:
        return Illuminator(SerialTransport(line))
    except DeviceError:
        line.close()
        raise


def _channels(bits: int) -> frozenset[int]:
    return frozenset(channel for channel in range(32) if bits >> channel & 1)
