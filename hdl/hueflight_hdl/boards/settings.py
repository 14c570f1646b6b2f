# SPDX-License-Identifier: Apache-2.0
"""Sizes and limits of a build that the user may choose, by name."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from hueflight_protocol.illuminator_map import (
    MAX_CHANNELS,
    MAX_FINE_STEPS,
    MAX_PULSES,
    MAX_STEPS,
)
from hueflight_protocol.reduction import MOST_ENTRY_BITS, MOST_SUM_BITS, MOST_SUMS
from hueflight_protocol.reduction_registers import ReductionRoom
from hueflight_protocol.wire import MAX_CODE_BITS, MAX_COLS, MAX_ROWS, MAX_RUN

from ..camera.camera import CameraConfig
from ..camera.formatter.formatter import MIN_BUFFER_WORDS
from ..camera.frame_format import FrameFormat
from ..camera.reduction.reducer import offset_group
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import Limits
from ..link.uart import bit_increment
from .target import Options, TargetError

_PULSE = ("channels", "pulses", "steps")
_OTHERS = ("baud", "serial", "reference_hz")
_LIMITS = ("max_on_ticks", "duty_divisor", "burst_ticks")
_FORM = ("rows", "cols", "code_bits", "lanes", "run", "geometry", "banks")
_CAMERA = ("buffer_words", "admit_words", "serial", "reference_hz")
_SENSOR = ("sensor", "overlap")
_SUMS = ("sums", "entry_bits", "sum_bits", "narrow_sums")
DEFAULT_ENTRY_BITS, DEFAULT_SUM_BITS = 3, 10
MAX_BAUD = 12_000_000
MAX_SERIAL = (1 << 64) - 1
MAX_REFERENCE_HZ = 200_000_000


@dataclass(frozen=True)
class Setting:
    """A number that the user may choose.

    Parameters
    ----------
    name : str
        Name in ``--set`` and in design files.
    meaning : str
        One line for the help.
    low, high : int
        Smallest and largest value.
    """

    name: str
    meaning: str
    low: int
    high: int

    def check(self, value: object, /) -> int:
        """Return a value as a number, or refuse it.

        Raises
        ------
        TargetError
            If it is not a whole number of the range.
        """
        try:
            number = int(value, 0) if isinstance(value, str) else value
        except ValueError:
            number = None
        if isinstance(number, bool) or not isinstance(number, int):
            raise TargetError(f"{self.name} = {value!r}: must be a whole number")
        if not self.low <= number <= self.high:
            raise TargetError(f"{self.name} = {number}: must be from {self.low} to {self.high}")
        return number


_REFERENCE = Setting(
    "reference_hz",
    "frequency of an external clock, on ECP5 boards with a pin for it; 0 = none",
    0,
    MAX_REFERENCE_HZ,
)
ILLUMINATOR = (
    Setting("channels", "LED channels", 1, MAX_CHANNELS),
    Setting("pulses", "pulses per channel and train", 1, MAX_PULSES),
    Setting("steps", "steps of a sequencer program", 1, MAX_STEPS),
    Setting("max_on_ticks", "longest on-time of an LED, in ticks", 1, 4095),
    Setting("duty_divisor", "divisor of the largest duty cycle; 1 = no limit", 1, 255),
    Setting("burst_ticks", "on-time allowed beyond the duty limit, in ticks", 1, 4095),
    Setting("baud", "rate of the serial line, in bits per second", 9600, MAX_BAUD),
    Setting("serial", "serial number of the board", 0, MAX_SERIAL),
    _REFERENCE,
    Setting("fine_delay", "1 = a fine delay line for each LED, on ECP5 boards; 0 = none", 0, 1),
)
CAMERA = (
    Setting("rows", "rows of the sensor", 1, MAX_ROWS),
    Setting("cols", "columns of the sensor", 1, MAX_COLS),
    Setting("code_bits", "width of a code", 1, MAX_CODE_BITS),
    Setting("lanes", "codes per clock at the sensor port: 1, 2, 4 or 8", 1, 8),
    Setting("run", "pixels per chunk, a multiple of 8", 8, MAX_RUN),
    Setting("geometry", "identity of the geometry in frame headers; 0 = not stated", 0, 0xFFFF),
    Setting(
        "banks",
        "chunks held between sensor and link: 2, 4, 8 or 16, enough for `run` and `lanes`",
        2,
        16,
    ),
    Setting(
        "buffer_words",
        "words between formatter and link, a power of two",
        MIN_BUFFER_WORDS,
        1 << 16,
    ),
    Setting("sensor", "1 = a sensor with serial lanes on pins, 0 = the synthetic one alone", 0, 1),
    Setting("overlap", "1 = the sensor on pins keeps its codes while it exposes", 0, 1),
    Setting("admit_words", "room in the buffer that a frame needs to be admitted", 3, 1 << 16),
    Setting("sums", "sums per pixel that codes can be reduced to; 0 = no reduction", 0, MOST_SUMS),
    Setting("entry_bits", "bits of an entry of the reduction's tables", 1, MOST_ENTRY_BITS),
    Setting("sum_bits", "bits of a sum", 1, MOST_SUM_BITS),
    Setting("narrow_sums", "last sums that have one bit less", 0, MOST_SUMS),
    Setting("serial", "serial number of the board", 0, MAX_SERIAL),
    _REFERENCE,
)
BY_DESIGN = {"illuminator": ILLUMINATOR, "camera": CAMERA}


def check_settings(design: str, values: Mapping[str, object], /) -> dict[str, int]:
    """Return checked settings of a design.

    Raises
    ------
    TargetError
        If a name is unknown or a value is out of range; the message lists what there is.
    """
    known = {setting.name: setting for setting in BY_DESIGN[design]}
    if unknown := set(values) - set(known):
        raise TargetError(
            f"the {design} has no setting {', '.join(sorted(unknown))}: "
            f"choose from {', '.join(known)}"
        )
    return {name: known[name].check(value) for name, value in values.items()}


def parse_settings(words: Iterable[str], /) -> dict[str, str]:
    """Return the settings of ``--set NAME=VALUE`` words.

    Raises
    ------
    TargetError
        If a word has another form or a name comes twice.
    """
    found: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign or not name.strip() or not value.strip():
            raise TargetError(f"--set {word}: must be NAME=VALUE")
        if name.strip() in found:
            raise TargetError(f"--set {word}: {name.strip()} is set twice")
        found[name.strip()] = value.strip()
    return found


def read_design_file(path: Path, /) -> dict[str, object]:
    """Return the settings of a design file: TOML with a line NAME = VALUE for each.

    Raises
    ------
    TargetError
        If it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise TargetError(f"{path}: {error}") from error


def write_design_file(path: Path, design: str, values: Mapping[str, int], /) -> None:
    """Write settings so that `read_design_file` reads them."""
    meanings = {setting.name: setting.meaning for setting in BY_DESIGN[design]}
    lines = [f"# settings of the {design}, for --design-file", ""]
    lines += [f"{name} = {value}  # {meanings[name]}" for name, value in values.items()]
    path.write_text("\n".join(lines) + "\n")


def set_illuminator(config: IlluminatorConfig, values: Mapping[str, int], /) -> IlluminatorConfig:
    """Return a configuration with other settings; limits apply to every channel.

    Raises
    ------
    ConfigError
        If they contradict one another.
    UartError
        If the clock does not allow the rate of the serial line.
    """
    pulse = config.pulse
    limits = {name: values[name] for name in _LIMITS if name in values}
    sizes = {name: values[name] for name in _PULSE if name in values}
    if limits:
        pulse = replace(pulse, limits=replace(_common_limits(config), **limits))
    rest = {name: values[name] for name in _OTHERS if name in values}
    if "fine_delay" in values:
        rest["fine_steps"] = MAX_FINE_STEPS if values["fine_delay"] else 0
    config = replace(config, pulse=replace(pulse, **sizes), **rest)
    bit_increment(config.sync_hz, config.baud)  # refuses a rate before anything is elaborated
    return config


def choose_illuminator(
    config: IlluminatorConfig,
    options: Options,
    /,
    *,
    board: str,
    leds: int,
    external_clock: bool = False,
    fine_delay: bool = False,
) -> IlluminatorConfig:
    """Return the configuration of a board with the settings that the user chose.

    Parameters
    ----------
    config : IlluminatorConfig
        What the board has by default; a board with fewer LEDs gets fewer channels.
    options : Options
        Choices of the user.
    board : str
        Name of the board, for messages.
    leds : int
        Pins that the board has for LEDs.
    external_clock : bool
        The board can run from an external clock.
    fine_delay : bool
        The board can have fine delay lines.

    Returns
    -------
    IlluminatorConfig
        What is built.

    Raises
    ------
    TargetError
        If there are more channels than pins, or there is no external clock or fine delay.
    """
    values = dict(options.settings)
    if not external_clock:
        needed = "a pin named reference, and an edge for its clock"
        refuse_reference(board, values.get("reference_hz", 0), needed)
    if values.get("fine_delay") and not fine_delay:
        raise TargetError(
            f"fine_delay = 1: {board} has no fine delay lines behind its outputs; ECP5 boards have"
        )
    if "channels" not in values and leds < config.pulse.channels:
        values["channels"] = leds
    if values.get("channels", 0) > leds:
        raise TargetError(
            f"channels = {values['channels']}: {board} has {leds} pins for LEDs (led_pulse)"
        )
    return set_illuminator(config, values)


def refuse_reference(board: str, reference_hz: int, needed: str, /) -> None:
    """Refuse an external clock.

    Parameters
    ----------
    board : str
        Name of the board, which cannot run from one.
    reference_hz : int
        Frequency that was asked for; 0 is not refused.
    needed : str
        What an ECP5 board needs, for the message.

    Raises
    ------
    TargetError
        If there is one.
    """
    if reference_hz:
        raise TargetError(
            f"reference_hz = {reference_hz}: {board} cannot run from an external clock; "
            f"ECP5 boards with {needed}, can"
        )


def illuminator_settings(config: IlluminatorConfig, /) -> dict[str, int]:
    """Return the settings of a configuration."""
    limits = _common_limits(config)
    return {
        **{name: getattr(config.pulse, name) for name in _PULSE},
        **{name: getattr(limits, name) for name in _LIMITS},
        "baud": round(config.baud),
        "serial": config.serial,
        "reference_hz": config.reference_hz,
        "fine_delay": int(config.fine_steps > 0),
    }


def set_camera(config: CameraConfig, values: Mapping[str, int], /) -> CameraConfig:
    """Return a configuration with other settings.

    A scene of the synthetic sensor is left to the caller, who knows the new format.

    Raises
    ------
    FormatError
        If they contradict one another.
    """
    form = replace(config.form, **{name: values[name] for name in _FORM if name in values})
    rest = {name: values[name] for name in _CAMERA if name in values}
    sensor = {name: bool(values[name]) for name in _SENSOR if name in values}
    return replace(config, form=form, **rest, **sensor, reduction=_reduction(form, values))


def _reduction(form: FrameFormat, values: Mapping[str, int]) -> ReductionRoom | None:
    """Return what the reduction is to have room for; None for no reduction.

    Raises
    ------
    TargetError
        If bits are given without sums.
    """
    if not values.get("sums"):
        for name in _SUMS[1:]:
            if name in values:
                raise TargetError(f"{name} = {values[name]}: sums must be 1 or more")
        return None
    return ReductionRoom(
        values["sums"],
        values.get("entry_bits", DEFAULT_ENTRY_BITS),
        values.get("sum_bits", DEFAULT_SUM_BITS),
        offset_group(form.lanes),
        values.get("narrow_sums", 0),
    )


def camera_settings(config: CameraConfig, /) -> dict[str, int]:
    """Return the settings of a configuration."""
    return {
        **{name: getattr(config.form, name) for name in _FORM},
        **{name: int(getattr(config, name)) for name in (*_CAMERA, *_SENSOR)},
        **_room_settings(config.reduction),
    }


def _room_settings(room: ReductionRoom | None) -> dict[str, int]:
    """Return the settings of a reduction; none without."""
    if room is None:
        return {"sums": 0}
    return dict(zip(_SUMS, (room.sums, room.entry_bits, room.sum_bits, room.narrow), strict=True))


def _common_limits(config: IlluminatorConfig) -> Limits:
    """Return the limits of all channels; builds for a board have the same for each."""
    return config.pulse.limit(0)
