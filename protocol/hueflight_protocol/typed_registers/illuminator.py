# SPDX-License-Identifier: Apache-2.0
"""Registers of the illuminator as types; written by `tools/typed_registers.py`, not by hand."""

from dataclasses import dataclass
from typing import ClassVar

from ..illuminator_map import Advance, Retrigger, TriggerSource
from ..register_value import RegisterValue
from .common import (
    Board,
    ClockHz,
    ClockSource,
    ClockState,
    Map,
    ReferenceHz,
    RequestErrors,
    Requests,
    Scratch,
    Serial,
    Source,
    Temperature,
    Uptime,
    Versions,
)

__all__ = [
    "Arm",
    "BankEnable",
    "BankPeriod",
    "BankSelect",
    "Board",
    "Capacity",
    "Clear",
    "ClockFailures",
    "ClockHz",
    "ClockSource",
    "ClockState",
    "DutyLimited",
    "Faults",
    "Features",
    "FineDelay",
    "FineStep",
    "Limit",
    "Map",
    "OnLimited",
    "Phase",
    "PhaseCount",
    "Pulse",
    "ReferenceHz",
    "RequestErrors",
    "Requests",
    "Restarts",
    "Scratch",
    "Sequencer",
    "SequencerControl",
    "Serial",
    "Source",
    "State",
    "StepCount",
    "StepIdle",
    "StepLeft",
    "StepMask",
    "StepSetup",
    "Swaps",
    "Temperature",
    "TickFs",
    "Trigger",
    "TriggerFilter",
    "TriggerNow",
    "TriggerOut",
    "TriggerPeriod",
    "TriggersIgnored",
    "TriggersSeen",
    "TriggersServed",
    "Uptime",
    "Versions",
    "WatchdogFeed",
    "WatchdogLeftMs",
    "WatchdogMs",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Features(RegisterValue):
    """What this build can do.

    Attributes
    ----------
    temperature : int
        The temperature is measured.
    clock_supervision : int
        Failures of the clock are detected and counted.
    external_clock : int
        The board can run from an external clock.
    fine_delay : int
        Channels have fine delay lines.
    """

    NAME: ClassVar[str] = "features"
    ADDRESS: ClassVar[int] = 0x0007
    TEMPERATURE_MAX: ClassVar[int] = 1
    CLOCK_SUPERVISION_MAX: ClassVar[int] = 1
    EXTERNAL_CLOCK_MAX: ClassVar[int] = 1
    FINE_DELAY_MAX: ClassVar[int] = 1

    temperature: int = 0
    clock_supervision: int = 0
    external_clock: int = 0
    fine_delay: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class State(RegisterValue):
    """What the board is doing.

    Attributes
    ----------
    armed : int
        LEDs may fire.
    busy : int
        A train is running.
    bank : int
        Schedule bank in use.
    swap_pending : int
        Another bank is selected and waits for the period's end.
    sequencing : int
        The sequencer is running.
    trigger_level : int
        Level of the trigger input.
    step : int
        Step of the sequencer.
    marker : int
        Value on the marker outputs.
    """

    NAME: ClassVar[str] = "state"
    ADDRESS: ClassVar[int] = 0x0008
    ARMED_MAX: ClassVar[int] = 1
    BUSY_MAX: ClassVar[int] = 1
    BANK_MAX: ClassVar[int] = 1
    SWAP_PENDING_MAX: ClassVar[int] = 1
    SEQUENCING_MAX: ClassVar[int] = 1
    TRIGGER_LEVEL_MAX: ClassVar[int] = 1
    STEP_MAX: ClassVar[int] = 255
    MARKER_MAX: ClassVar[int] = 255

    armed: int = 0
    busy: int = 0
    bank: int = 0
    swap_pending: int = 0
    sequencing: int = 0
    trigger_level: int = 0
    step: int = 0
    marker: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults(RegisterValue):
    """What went wrong since last cleared.

    Attributes
    ----------
    watchdog : int
        The watchdog disarmed the board.
    on_limit : int
        A pulse was cut at the longest on-time.
    duty_limit : int
        A pulse was held back by the duty limit.
    trigger_ignored : int
        A trigger came while a train was running.
    saturated : int
        A counter stands at its largest value.
    clock_failed : int
        The clock failed, which disarmed the board.
    reference_lost : int
        The external clock was lost while in use.
    """

    NAME: ClassVar[str] = "faults"
    ADDRESS: ClassVar[int] = 0x0009
    WATCHDOG_MAX: ClassVar[int] = 1
    ON_LIMIT_MAX: ClassVar[int] = 1
    DUTY_LIMIT_MAX: ClassVar[int] = 1
    TRIGGER_IGNORED_MAX: ClassVar[int] = 1
    SATURATED_MAX: ClassVar[int] = 1
    CLOCK_FAILED_MAX: ClassVar[int] = 1
    REFERENCE_LOST_MAX: ClassVar[int] = 1

    watchdog: int = 0
    on_limit: int = 0
    duty_limit: int = 0
    trigger_ignored: int = 0
    saturated: int = 0
    clock_failed: int = 0
    reference_lost: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Capacity(RegisterValue):
    """Size of this build.

    Attributes
    ----------
    channels : int
        LED channels.
    pulses : int
        Pulses per channel and period.
    steps : int
        Steps of a sequencer program.
    lanes : int
        Ticks per clock.
    """

    NAME: ClassVar[str] = "capacity"
    ADDRESS: ClassVar[int] = 0x0010
    CHANNELS_MAX: ClassVar[int] = 255
    PULSES_MAX: ClassVar[int] = 255
    STEPS_MAX: ClassVar[int] = 255
    LANES_MAX: ClassVar[int] = 255

    channels: int
    pulses: int
    steps: int
    lanes: int


@dataclass(frozen=True, slots=True)
class TickFs(RegisterValue):
    """Length of a tick.

    Attributes
    ----------
    value : int
        Value, in fs.
    """

    NAME: ClassVar[str] = "tick_fs"
    ADDRESS: ClassVar[int] = 0x0011
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FineStep(RegisterValue):
    """Fine delay lines, in builds with them.

    Attributes
    ----------
    steps : int
        Settings of a line, 0 included.
    step_fs : int
        Nominal step, in fs.
    """

    NAME: ClassVar[str] = "fine_step"
    ADDRESS: ClassVar[int] = 0x0015
    STEPS_MAX: ClassVar[int] = 255
    STEP_FS_MAX: ClassVar[int] = 16777215

    steps: int
    step_fs: int


@dataclass(frozen=True, slots=True)
class Arm(RegisterValue):
    """Arm or disarm; the board is disarmed after reset.

    Attributes
    ----------
    value : int
        `0x214d5241` arms, anything else disarms.
    """

    NAME: ClassVar[str] = "arm"
    ADDRESS: ClassVar[int] = 0x0018
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class WatchdogMs(RegisterValue):
    """Time without a feed after which the board disarms itself.

    Attributes
    ----------
    value : int
        0 keeps the board disarmed, in ms.
    """

    NAME: ClassVar[str] = "watchdog_ms"
    ADDRESS: ClassVar[int] = 0x0019
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True)
class WatchdogFeed(RegisterValue):
    """Feed the watchdog.

    Attributes
    ----------
    value : int
        Start the time again.
    """

    NAME: ClassVar[str] = "watchdog_feed"
    ADDRESS: ClassVar[int] = 0x001A
    VALUE_MAX: ClassVar[int] = 1

    value: int


@dataclass(frozen=True, slots=True)
class WatchdogLeftMs(RegisterValue):
    """Time left until disarm.

    Attributes
    ----------
    value : int
        Value, in ms.
    """

    NAME: ClassVar[str] = "watchdog_left_ms"
    ADDRESS: ClassVar[int] = 0x001B
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True)
class OnLimited(RegisterValue):
    """Channels whose on-time was cut.

    Attributes
    ----------
    value : int
        Bit k: channel k.
    """

    NAME: ClassVar[str] = "on_limited"
    ADDRESS: ClassVar[int] = 0x001C

    value: int


@dataclass(frozen=True, slots=True)
class DutyLimited(RegisterValue):
    """Channels held back by the duty limit.

    Attributes
    ----------
    value : int
        Bit k: channel k.
    """

    NAME: ClassVar[str] = "duty_limited"
    ADDRESS: ClassVar[int] = 0x001D

    value: int


@dataclass(frozen=True, slots=True)
class ClockFailures(RegisterValue):
    """Failures of the clock (the PLL lost lock) since configuration, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "clock_failures"
    ADDRESS: ClassVar[int] = 0x001E
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger(RegisterValue):
    """Trigger.

    Attributes
    ----------
    source : TriggerSource | int
        What starts a train.
    retrigger : Retrigger | int
        A trigger during a train.
    falling : int
        The external trigger's falling edge counts.
    output : int
        Send a trigger-out with every train.
    """

    NAME: ClassVar[str] = "trigger"
    ADDRESS: ClassVar[int] = 0x0020
    SOURCE_MAX: ClassVar[int] = 3
    RETRIGGER_MAX: ClassVar[int] = 1
    FALLING_MAX: ClassVar[int] = 1
    OUTPUT_MAX: ClassVar[int] = 1

    source: TriggerSource | int = 0
    retrigger: Retrigger | int = 0
    falling: int = 0
    output: int = 0


@dataclass(frozen=True, slots=True)
class TriggerPeriod(RegisterValue):
    """Period of the internal trigger; at least 8 clocks.

    Attributes
    ----------
    value : int
        Value, in tick.
    """

    NAME: ClassVar[str] = "trigger_period"
    ADDRESS: ClassVar[int] = 0x0021
    VALUE_MAX: ClassVar[int] = 65535

    value: int


@dataclass(frozen=True, slots=True)
class TriggerNow(RegisterValue):
    """Software trigger.

    Attributes
    ----------
    value : int
        Start a train.
    """

    NAME: ClassVar[str] = "trigger_now"
    ADDRESS: ClassVar[int] = 0x0022
    VALUE_MAX: ClassVar[int] = 1

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggerOut(RegisterValue):
    """Trigger for a camera that follows.

    Attributes
    ----------
    delay : int
        After the trigger, in tick.
    width : int
        0 = no pulse, in tick.
    """

    NAME: ClassVar[str] = "trigger_out"
    ADDRESS: ClassVar[int] = 0x0023
    DELAY_MAX: ClassVar[int] = 4095
    WIDTH_MAX: ClassVar[int] = 4095

    delay: int = 0
    width: int = 8


@dataclass(frozen=True, slots=True)
class TriggerFilter(RegisterValue):
    """Time without another change before and after an edge of the trigger that counts.

    Attributes
    ----------
    width : int
        0 = no filter; more than 8 acts as 8, in tick.
    """

    NAME: ClassVar[str] = "trigger_filter"
    ADDRESS: ClassVar[int] = 0x0024
    WIDTH_MAX: ClassVar[int] = 15

    width: int


@dataclass(frozen=True, slots=True)
class TriggersSeen(RegisterValue):
    """Edges, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "triggers_seen"
    ADDRESS: ClassVar[int] = 0x0028
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class TriggersServed(RegisterValue):
    """Trains begun, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "triggers_served"
    ADDRESS: ClassVar[int] = 0x0029
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class TriggersIgnored(RegisterValue):
    """Edges without a train, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "triggers_ignored"
    ADDRESS: ClassVar[int] = 0x002A
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Restarts(RegisterValue):
    """Trains cut by a retrigger, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "restarts"
    ADDRESS: ClassVar[int] = 0x002B
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class Swaps(RegisterValue):
    """Changes of bank, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "swaps"
    ADDRESS: ClassVar[int] = 0x002C
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Clear(RegisterValue):
    """Set statistics to 0.

    Attributes
    ----------
    counters : int
        The five registers before this one.
    phase : int
        The phase registers.
    """

    NAME: ClassVar[str] = "clear"
    ADDRESS: ClassVar[int] = 0x002D
    COUNTERS_MAX: ClassVar[int] = 1
    PHASE_MAX: ClassVar[int] = 1

    counters: int = 0
    phase: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase(RegisterValue):
    """Position of served external triggers within the clock.

    Attributes
    ----------
    last : int
        Phase of the last trigger, in tick.
    min : int
        Smallest phase since cleared, in tick.
    max : int
        Largest phase since cleared, in tick.
    valid : int
        A trigger was seen since cleared.
    """

    NAME: ClassVar[str] = "phase"
    ADDRESS: ClassVar[int] = 0x0030
    LAST_MAX: ClassVar[int] = 255
    MIN_MAX: ClassVar[int] = 255
    MAX_MAX: ClassVar[int] = 255
    VALID_MAX: ClassVar[int] = 1

    last: int = 0
    min: int = 0
    max: int = 0
    valid: int = 0


@dataclass(frozen=True, slots=True)
class PhaseCount(RegisterValue):
    """Served external triggers at each phase, saturating.

    Attributes
    ----------
    value : int
        Number.
    """

    NAME: ClassVar[str] = "phase_count"
    ADDRESS: ClassVar[int] = 0x0038
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class BankSelect(RegisterValue):
    """Bank wanted; taken over when the period ends. The sequencer has precedence.

    Attributes
    ----------
    value : int
        Bank.
    """

    NAME: ClassVar[str] = "bank_select"
    ADDRESS: ClassVar[int] = 0x0040
    VALUE_MAX: ClassVar[int] = 1

    value: int


@dataclass(frozen=True, slots=True)
class BankPeriod(RegisterValue):
    """Length of a train, per bank; whole clocks of it count, 8 at least.

    Attributes
    ----------
    value : int
        1 to 4096, in tick.
    """

    NAME: ClassVar[str] = "bank_period"
    ADDRESS: ClassVar[int] = 0x0042
    VALUE_MAX: ClassVar[int] = 8191

    value: int


@dataclass(frozen=True, slots=True)
class BankEnable(RegisterValue):
    """Channels that fire, per bank.

    Attributes
    ----------
    value : int
        Bit k: channel k.
    """

    NAME: ClassVar[str] = "bank_enable"
    ADDRESS: ClassVar[int] = 0x0044

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequencer(RegisterValue):
    """How the program runs.

    Attributes
    ----------
    advance : Advance | int
        What steps count.
    loop : int
        Begin again after the last step.
    length : int
        Steps in the program.
    """

    NAME: ClassVar[str] = "sequencer"
    ADDRESS: ClassVar[int] = 0x0050
    ADVANCE_MAX: ClassVar[int] = 1
    LOOP_MAX: ClassVar[int] = 1
    LENGTH_MAX: ClassVar[int] = 255

    advance: Advance | int = 0
    loop: int = 0
    length: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class SequencerControl(RegisterValue):
    """Start and stop the program.

    Attributes
    ----------
    start : int
        Begin at step 0 with the next period.
    stop : int
        End after the period that is running.
    sync : int
        A frame sync from the host.
    """

    NAME: ClassVar[str] = "sequencer_control"
    ADDRESS: ClassVar[int] = 0x0051
    START_MAX: ClassVar[int] = 1
    STOP_MAX: ClassVar[int] = 1
    SYNC_MAX: ClassVar[int] = 1

    start: int = 0
    stop: int = 0
    sync: int = 0


@dataclass(frozen=True, slots=True)
class StepLeft(RegisterValue):
    """What is left of the present step, its idle part included; saturating.

    Attributes
    ----------
    value : int
        Triggers or frame syncs.
    """

    NAME: ClassVar[str] = "step_left"
    ADDRESS: ClassVar[int] = 0x0052
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit(RegisterValue):
    """What no register can exceed, per channel.

    In any stretch of L ticks it is on for at most L / `duty_divisor` + `burst_ticks`.

    Attributes
    ----------
    on_ticks : int
        On at most this long without a pause, in tick.
    burst_ticks : int
        On-time allowed beyond the duty limit, in tick.
    duty_divisor : int
        Divisor of the largest duty cycle; 1 = no limit.
    """

    NAME: ClassVar[str] = "limit"
    ADDRESS: ClassVar[int] = 0x0060
    ON_TICKS_MAX: ClassVar[int] = 4095
    BURST_TICKS_MAX: ClassVar[int] = 4095
    DUTY_DIVISOR_MAX: ClassVar[int] = 255

    on_ticks: int = 0
    burst_ticks: int = 0
    duty_divisor: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class StepSetup(RegisterValue):
    """Bank and marker of a step.

    Attributes
    ----------
    bank : int
        Schedule bank.
    marker : int
        Value on the marker outputs.
    """

    NAME: ClassVar[str] = "step_setup"
    ADDRESS: ClassVar[int] = 0x0080
    BANK_MAX: ClassVar[int] = 1
    MARKER_MAX: ClassVar[int] = 255

    bank: int = 0
    marker: int = 0


@dataclass(frozen=True, slots=True)
class StepMask(RegisterValue):
    """Channels of a step.

    Attributes
    ----------
    value : int
        Bit k: channel k fires.
    """

    NAME: ClassVar[str] = "step_mask"
    ADDRESS: ClassVar[int] = 0x0081

    value: int


@dataclass(frozen=True, slots=True)
class StepCount(RegisterValue):
    """Length of a step.

    Attributes
    ----------
    value : int
        Triggers or frame syncs; 0 = skip.
    """

    NAME: ClassVar[str] = "step_count"
    ADDRESS: ClassVar[int] = 0x0082
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True)
class StepIdle(RegisterValue):
    """Dark time after a step.

    Attributes
    ----------
    value : int
        Triggers or frame syncs.
    """

    NAME: ClassVar[str] = "step_idle"
    ADDRESS: ClassVar[int] = 0x0083
    VALUE_MAX: ClassVar[int] = 4294967295

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse(RegisterValue):
    """Schedule: bank, channel, pulse. Write the bank that is not in use.

    Attributes
    ----------
    delay : int
        From the trigger to the rising edge, in tick.
    width : int
        0 = no pulse, in tick.
    """

    NAME: ClassVar[str] = "pulse"
    ADDRESS: ClassVar[int] = 0x0100
    DELAY_MAX: ClassVar[int] = 4095
    WIDTH_MAX: ClassVar[int] = 4095

    delay: int = 0
    width: int = 0


@dataclass(frozen=True, slots=True)
class FineDelay(RegisterValue):
    """Fine delay of a channel, in builds with delay lines.

    Added to all its pulses. Writes are refused while the board is armed; LEDs stay off until the
    lines have moved.

    Attributes
    ----------
    value : int
        Value, in step.
    """

    NAME: ClassVar[str] = "fine_delay"
    ADDRESS: ClassVar[int] = 0x0200
    VALUE_MAX: ClassVar[int] = 127

    value: int
