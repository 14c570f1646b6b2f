# SPDX-License-Identifier: Apache-2.0
"""Sizes and limits of a build that the user may choose, by name."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..camera.camera import CameraConfig
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import Limits
from .target import Options, TargetError

_PULSE = ("channels", "pulses", "steps")
_LIMITS = ("max_on_ticks", "duty_divisor", "burst_ticks")
_FORM = ("rows", "cols", "code_bits", "lanes", "run", "geometry", "banks")
_CAMERA = ("buffer_words", "admit_words", "serial")
MAX_BAUD = 12_000_000
MAX_SERIAL = (1 << 64) - 1


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


ILLUMINATOR = (
    Setting("channels", "LED channels", 1, 32),
    Setting("pulses", "pulses per channel and train", 1, 4),
    Setting("steps", "steps of a sequencer program", 1, 32),
    Setting("max_on_ticks", "longest on-time of an LED, in ticks", 1, 4095),
    Setting("duty_divisor", "divisor of the largest duty cycle; 1 = no limit", 1, 255),
    Setting("burst_ticks", "on-time allowed beyond the duty limit, in ticks", 1, 4095),
    Setting("baud", "rate of the serial line, in bits per second", 9600, MAX_BAUD),
    Setting("serial", "serial number of the board", 0, MAX_SERIAL),
)
CAMERA = (
    Setting("rows", "rows of the sensor", 1, 1024),
    Setting("cols", "columns of the sensor", 1, 1024),
    Setting("code_bits", "width of a code", 1, 16),
    Setting("lanes", "codes per clock at the sensor port: 1, 2, 4 or 8", 1, 8),
    Setting("run", "pixels per chunk, a multiple of 8", 8, 4096),
    Setting("geometry", "identity of the geometry in frame headers; 0 = not stated", 0, 0xFFFF),
    Setting("banks", "chunks held between sensor and link: 2, 4, 8 or 16", 2, 16),
    Setting("buffer_words", "words between formatter and link, a power of two", 16, 1 << 16),
    Setting("admit_words", "room in the buffer that a frame needs to be admitted", 3, 1 << 16),
    Setting("serial", "serial number of the board", 0, MAX_SERIAL),
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
    """
    pulse = config.pulse
    limits = {name: values[name] for name in _LIMITS if name in values}
    sizes = {name: values[name] for name in _PULSE if name in values}
    if limits:
        pulse = replace(pulse, limits=replace(_common_limits(config), **limits))
    rest = {name: values[name] for name in ("baud", "serial") if name in values}
    return replace(config, pulse=replace(pulse, **sizes), **rest)


def choose_illuminator(
    config: IlluminatorConfig, options: Options, /, *, board: str, leds: int
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

    Returns
    -------
    IlluminatorConfig
        What is built.

    Raises
    ------
    TargetError
        If there are more channels than pins.
    """
    values = dict(options.settings)
    if "channels" not in values and leds < config.pulse.channels:
        values["channels"] = leds
    if values.get("channels", 0) > leds:
        raise TargetError(
            f"channels = {values['channels']}: {board} has {leds} pins for LEDs (led_pulse)"
        )
    return set_illuminator(config, values)


def illuminator_settings(config: IlluminatorConfig, /) -> dict[str, int]:
    """Return the settings of a configuration."""
    limits = _common_limits(config)
    return {
        **{name: getattr(config.pulse, name) for name in _PULSE},
        **{name: getattr(limits, name) for name in _LIMITS},
        "baud": round(config.baud),
        "serial": config.serial,
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
    return replace(config, form=form, **rest)


def camera_settings(config: CameraConfig, /) -> dict[str, int]:
    """Return the settings of a configuration."""
    return {
        **{name: getattr(config.form, name) for name in _FORM},
        **{name: getattr(config, name) for name in _CAMERA},
    }


def _common_limits(config: IlluminatorConfig) -> Limits:
    """Return the limits of all channels; builds for a board have the same for each."""
    return config.pulse.limit(0)
