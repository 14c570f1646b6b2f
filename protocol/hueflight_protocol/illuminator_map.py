# SPDX-License-Identifier: Apache-2.0
"""Register map of the illuminator: the board that fires the LEDs."""

from enum import IntEnum

from .clock_registers import EXTERNAL_CLOCK, REFERENCE_LOST, clock_failures, clock_registers
from .common_map import common_registers
from .errors import RegisterError
from .registers import Access, Field, Parts, Register, RegisterMap, Reserved, value

BOARD = b"HILL"
ARM_KEY = 0x214D5241
"""``ARM!`` in ASCII."""
BANKS = 2
MAX_CHANNELS = 32
MAX_PULSES = 4
MAX_STEPS = 32
MAX_LANES = 8
MAX_PERIOD_TICKS = 4096
MIN_PERIOD_CLOCKS = 8
"""Trains are at least this many clocks apart, whatever starts them."""
MAX_FILTER_TICKS = 8
"""Largest width of the filter of the trigger input."""
MAX_FINE_STEPS = 128
"""Settings of a fine delay line, 0 included."""
FINE_STEP_FS = 25_000
"""Nominal step of the fine delay lines of an ECP5, in femtoseconds."""
_DELAY_BITS = 12


class TriggerSource(IntEnum):
    """What starts a train."""

    EXTERNAL = 0
    INTERNAL = 1
    SOFTWARE = 2


class Retrigger(IntEnum):
    """What a trigger does while a train runs."""

    IGNORE = 0
    RESTART = 1


class Advance(IntEnum):
    """What a sequencer step counts."""

    TRIGGERS = 0
    FRAME_SYNC = 1


def illuminator_map(
    *,
    channels: int = 9,
    pulses: int = MAX_PULSES,
    steps: int = MAX_STEPS,
    lanes: int = 4,
    tick_fs: int = 1_250_000,
    clock_hz: int = 200_000_000,
    external_clock: bool = False,
    reference_hz: int = 0,
    fine_steps: int = 0,
    fine_step_fs: int = FINE_STEP_FS,
) -> RegisterMap:
    """Return the illuminator's register map; addresses are the same for every build.

    Parameters
    ----------
    channels : int
        LED channels, 1 to 32.
    pulses : int
        Pulses per channel and period, 1 to 4.
    steps : int
        Steps that a sequencer program may have, 1 to 32.
    lanes : int
        Ticks per clock, 1 to 8.
    tick_fs : int
        Length of a tick in femtoseconds.
    clock_hz : int
        Frequency of the pulse generator's clock.
    external_clock : bool
        The build can run from an external clock; otherwise it has no registers for that.
    reference_hz : int
        Frequency of the external clock.
    fine_steps : int
        Settings of each channel's fine delay line, 2 to 128; 0 if the build has none, and no
        registers for them.
    fine_step_fs : int
        Nominal step of the lines in femtoseconds.

    Returns
    -------
    RegisterMap
        The registers.

    Raises
    ------
    RegisterError
        If a number is out of its range.
    """
    for name, number, high in (
        ("channels", channels, MAX_CHANNELS),
        ("pulses", pulses, MAX_PULSES),
        ("steps", steps, MAX_STEPS),
        ("lanes", lanes, MAX_LANES),
    ):
        if not 1 <= number <= high:
            raise RegisterError(f"{name} = {number}: must be from 1 to {high}")
    if fine_steps and not 2 <= fine_steps <= MAX_FINE_STEPS:
        raise RegisterError(f"fine_steps = {fine_steps}: must be 0, or from 2 to {MAX_FINE_STEPS}")
    build = [
        Register(
            "capacity",
            0x010,
            Access.CONST,
            (
                Field("channels", 8, "LED channels", reset=channels),
                Field("pulses", 8, "pulses per channel and period", reset=pulses),
                Field("steps", 8, "steps of a sequencer program", reset=steps),
                Field("lanes", 8, "ticks per clock", reset=lanes),
            ),
            "size of this build",
        ),
        Register(
            "tick_fs",
            0x011,
            Access.CONST,
            value(32, "", reset=tick_fs, unit="fs"),
            "length of a tick",
        ),
    ]
    common = common_registers(
        BOARD,
        clock_hz=clock_hz,
        features=_features(external_clock=external_clock, fine_delay=bool(fine_steps)),
        state=_STATE,
        faults=(*_FAULTS, REFERENCE_LOST) if external_clock else _FAULTS,
    )
    return RegisterMap(
        "illuminator",
        [
            *common,
            *build,
            *(clock_registers(reference_hz) if external_clock else ()),
            *(_fine(channels, fine_steps, fine_step_fs) if fine_steps else ()),
            *_safety(channels),
            *_trigger(lanes),
            *_sequencer(channels, steps),
            *_schedule(channels, pulses),
        ],
    )


_FEATURES = (
    Field("temperature", 1, "the temperature is measured"),
    Field("clock_supervision", 1, "failures of the clock are detected and counted"),
)
_FINE_DELAY = Field("fine_delay", 1, "channels have fine delay lines")


def _features(*, external_clock: bool, fine_delay: bool) -> Parts:
    """Return the bits of features, which stand at the same places in every build."""
    parts: Parts = (*_FEATURES, EXTERNAL_CLOCK) if external_clock else _FEATURES
    if fine_delay:
        parts = (*parts, *(() if external_clock else (Reserved(1),)), _FINE_DELAY)
    return parts


_STATE = (
    Field("armed", 1, "LEDs may fire"),
    Field("busy", 1, "a train is running"),
    Field("bank", 1, "schedule bank in use"),
    Field("swap_pending", 1, "another bank is selected and waits for the period's end"),
    Field("sequencing", 1, "the sequencer is running"),
    Field("trigger_level", 1, "level of the trigger input"),
    Reserved(2),
    Field("step", 8, "step of the sequencer"),
    Field("marker", 8, "value on the marker outputs"),
)

_FAULTS = (
    Field("watchdog", 1, "the watchdog disarmed the board"),
    Field("on_limit", 1, "a pulse was cut at the longest on-time"),
    Field("duty_limit", 1, "a pulse was held back by the duty limit"),
    Field("trigger_ignored", 1, "a trigger came while a train was running"),
    Field("saturated", 1, "a counter stands at its largest value"),
    Field("clock_failed", 1, "the clock failed, which disarmed the board"),
)


def _fine(channels: int, steps: int, step_fs: int) -> list[Register]:
    return [
        Register(
            "fine_step",
            0x015,
            Access.CONST,
            (
                Field("steps", 8, "settings of a line, 0 included", reset=steps),
                Field("step_fs", 24, "nominal step", reset=step_fs, unit="fs"),
            ),
            "fine delay lines, in builds with them",
        ),
        Register(
            "fine_delay",
            0x200,
            Access.RW,
            value(7, "", unit="step"),
            "fine delay of a channel, in builds with delay lines: added to all its pulses. Writes "
            "are refused while the board is armed; LEDs stay off until the lines have moved",
            count=(channels,),
            strides=(1,),
        ),
    ]


def _safety(channels: int) -> list[Register]:
    return [
        Register(
            "arm",
            0x018,
            Access.KEY,
            value(32, f"`{ARM_KEY:#010x}` arms, anything else disarms"),
            "arm or disarm; the board is disarmed after reset",
        ),
        Register(
            "watchdog_ms",
            0x019,
            Access.RW,
            value(16, "0 keeps the board disarmed", reset=1000, unit="ms"),
            "time without a feed after which the board disarms itself",
        ),
        Register(
            "watchdog_feed",
            0x01A,
            Access.PULSE,
            value(1, "start the time again"),
            "feed the watchdog",
        ),
        Register(
            "watchdog_left_ms", 0x01B, Access.RO, value(16, "", unit="ms"), "time left until disarm"
        ),
        Register(
            "on_limited",
            0x01C,
            Access.W1C,
            value(channels, "bit k: channel k"),
            "channels whose on-time was cut",
        ),
        Register(
            "duty_limited",
            0x01D,
            Access.W1C,
            value(channels, "bit k: channel k"),
            "channels held back by the duty limit",
        ),
        clock_failures(0x01E),
        Register(
            "limit",
            0x060,
            Access.CONST,
            (
                Field("on_ticks", 12, "on at most this long without a pause", unit="tick"),
                Field("burst_ticks", 12, "on-time allowed beyond the duty limit", unit="tick"),
                Field("duty_divisor", 8, "divisor of the largest duty cycle; 1 = no limit"),
            ),
            "what no register can exceed, per channel: in any stretch of L ticks it is on for at "
            "most L / `duty_divisor` + `burst_ticks`",
            count=(channels,),
            strides=(1,),
        ),
    ]


def _trigger(lanes: int) -> list[Register]:
    counter = value(32, "number")
    return [
        Register(
            "trigger",
            0x020,
            Access.RW,
            (
                Field("source", 2, "what starts a train", choices=TriggerSource),
                Field("retrigger", 1, "a trigger during a train", choices=Retrigger),
                Field("falling", 1, "the external trigger's falling edge counts"),
                Field("output", 1, "send a trigger-out with every train"),
            ),
            "trigger",
        ),
        Register(
            "trigger_period",
            0x021,
            Access.RW,
            value(16, "", reset=256, unit="tick"),
            f"period of the internal trigger; at least {MIN_PERIOD_CLOCKS} clocks",
        ),
        Register("trigger_now", 0x022, Access.PULSE, value(1, "start a train"), "software trigger"),
        Register(
            "trigger_out",
            0x023,
            Access.RW,
            (
                Field("delay", _DELAY_BITS, "after the trigger", unit="tick"),
                Reserved(4),
                Field("width", 12, "0 = no pulse", reset=8, unit="tick"),
            ),
            "trigger for a camera that follows",
        ),
        Register(
            "trigger_filter",
            0x024,
            Access.RW,
            (
                Field(
                    "width",
                    4,
                    f"0 = no filter; more than {MAX_FILTER_TICKS} acts as {MAX_FILTER_TICKS}",
                    unit="tick",
                ),
            ),
            "time without another change before and after an edge of the trigger that counts",
        ),
        Register("triggers_seen", 0x028, Access.RO, counter, "edges, saturating"),
        Register("triggers_served", 0x029, Access.RO, counter, "trains begun, saturating"),
        Register(
            "triggers_ignored", 0x02A, Access.RO, counter, "edges without a train, saturating"
        ),
        Register("restarts", 0x02B, Access.RO, counter, "trains cut by a retrigger, saturating"),
        Register("swaps", 0x02C, Access.RO, counter, "changes of bank, saturating"),
        Register(
            "clear",
            0x02D,
            Access.PULSE,
            (
                Field("counters", 1, "the five registers before this one"),
                Field("phase", 1, "the phase registers"),
            ),
            "set statistics to 0",
        ),
        Register(
            "phase",
            0x030,
            Access.RO,
            (
                Field("last", 8, "phase of the last trigger", unit="tick"),
                Field("min", 8, "smallest phase since cleared", unit="tick"),
                Field("max", 8, "largest phase since cleared", unit="tick"),
                Field("valid", 1, "a trigger was seen since cleared"),
            ),
            "position of served external triggers within the clock",
        ),
        Register(
            "phase_count",
            0x038,
            Access.RO,
            counter,
            "served external triggers at each phase, saturating",
            count=(lanes,),
            strides=(1,),
        ),
    ]


def _sequencer(channels: int, steps: int) -> list[Register]:
    def program(name: str, offset: int, parts: Parts, doc: str) -> Register:
        return Register(name, 0x080 + offset, Access.RW, parts, doc, count=(steps,), strides=(4,))

    return [
        Register(
            "sequencer",
            0x050,
            Access.RW,
            (
                Field("advance", 1, "what steps count", choices=Advance),
                Field("loop", 1, "begin again after the last step"),
                Reserved(6),
                Field("length", 8, "steps in the program", reset=1),
            ),
            "how the program runs",
        ),
        Register(
            "sequencer_control",
            0x051,
            Access.PULSE,
            (
                Field("start", 1, "begin at step 0 with the next period"),
                Field("stop", 1, "end after the period that is running"),
                Field("sync", 1, "a frame sync from the host"),
            ),
            "start and stop the program",
        ),
        Register(
            "step_left",
            0x052,
            Access.RO,
            value(32, "triggers or frame syncs"),
            "what is left of the present step, its idle part included; saturating",
        ),
        program(
            "step_setup",
            0,
            (
                Field("bank", 1, "schedule bank"),
                Reserved(7),
                Field("marker", 8, "value on the marker outputs"),
            ),
            "bank and marker of a step",
        ),
        program("step_mask", 1, value(channels, "bit k: channel k fires"), "channels of a step"),
        program(
            "step_count", 2, value(32, "triggers or frame syncs; 0 = skip"), "length of a step"
        ),
        program("step_idle", 3, value(32, "triggers or frame syncs"), "dark time after a step"),
    ]


def _schedule(channels: int, pulses: int) -> list[Register]:
    return [
        Register(
            "bank_select",
            0x040,
            Access.RW,
            value(1, "bank"),
            "bank wanted; taken over when the period ends. The sequencer has precedence",
        ),
        Register(
            "bank_period",
            0x042,
            Access.RW,
            value(13, f"1 to {MAX_PERIOD_TICKS}", reset=256, unit="tick"),
            f"length of a train, per bank; whole clocks of it count, {MIN_PERIOD_CLOCKS} at least",
            count=(BANKS,),
            strides=(1,),
        ),
        Register(
            "bank_enable",
            0x044,
            Access.RW,
            value(channels, "bit k: channel k"),
            "channels that fire, per bank",
            count=(BANKS,),
            strides=(1,),
        ),
        Register(
            "pulse",
            0x100,
            Access.RW,
            (
                Field("delay", _DELAY_BITS, "from the trigger to the rising edge", unit="tick"),
                Reserved(4),
                Field("width", 12, "0 = no pulse", unit="tick"),
            ),
            "schedule: bank, channel, pulse. Write the bank that is not in use",
            count=(BANKS, channels, pulses),
            strides=(MAX_CHANNELS * MAX_PULSES, MAX_PULSES, 1),
        ),
    ]
