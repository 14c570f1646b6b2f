# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight board`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from hueflight.cli.exit_codes import FAILED
from hueflight.cli.output import error_console, print_notice, show
from hueflight.devices.built_in_rigs import open_usb_camera
from hueflight.devices.camera import Camera
from hueflight.devices.camera_selftest import run_camera_selftest
from hueflight.devices.clock_choice import ClockName
from hueflight.devices.errors import DeviceError
from hueflight.devices.illuminator import Illuminator, open_illuminator
from hueflight.devices.illuminator_selftest import run_illuminator_selftest
from hueflight.devices.selftest import WORDS, SelfTestResult
from hueflight.devices.skew import measure_skew

_USB = "usb:"
_ACTIONS = {
    "--source": "clock",
    "--led": "skew",
    "--yes": "skew",
    "--no-leds": "selftest",
    "--loop": "selftest",
    "--dwell": "selftest",
    "--words": "selftest",
}
"""Options that belong to one action."""
_ILLUMINATOR = ("--no-leds", "--loop", "--dwell", "--baud", "--record")
"""Options that a camera does not have."""
_DWELL_S = 0.5


def board(
    action: Literal["selftest", "clock", "skew"],
    port: str,
    /,
    *,
    source: ClockName | None = None,
    led: list[int] | None = None,
    yes: Annotated[bool, Parameter(negative=())] = False,
    baud: int | None = None,
    leds: Annotated[bool, Parameter(negative="--no-leds")] = True,
    loop: Annotated[bool, Parameter(negative=())] = False,
    dwell: float | None = None,
    words: int | None = None,
    record: Path | None = None,
    json: bool = False,
) -> int:
    """Test a board, choose its clock, or measure the skew of LEDs.

    The test of an illuminator covers clock, line, temperature, each LED, and the watchdog. LEDs
    fire one after another, for 10 ns in every 82 µs or longer. That of a camera covers line,
    temperature, the link with known words, and 1000 frames. The exit code is 1 if a test fails. The
    clock is the board's oscillator or an external one; a change disarms an illuminator. For the
    skew, the output of one LED after another is led to the trigger input, by a wire or by its light
    on a photodiode; this needs gateware with fine delays.

    Parameters
    ----------
    action : str
        What to do: selftest, clock, or skew.
    port : str
        Serial port of an illuminator, such as /dev/ttyUSB0, or a camera, usb: or usb:SERIAL, which
        has no skew.
    source : {"internal", "external"}, optional
        Clock to run from, with the action clock; by default the clock is only shown.
    led : list of int, optional
        Number of an LED to measure, with the action skew; can be given more than once. By default
        all are.
    yes : bool, default False
        Begin with each LED without asking, as where a photodiode sees all of them.
    baud : int, optional
        Line rate in bits per second. By default it is found by asking the board.
    leds : bool, default True
        Whether LEDs may fire; without, the walk and the watchdog are left out.
    loop : bool, default False
        A wire leads the trigger output of the illuminator to its trigger input: test both.
    dwell : float, optional
        Shortest time for which each LED fires, in seconds; by default 0.5.
    words : int, optional
        Number of words that are sent to the board and back; by default 2000.
    record : Path, optional
        Write all transactions with the board to this file, as JSON lines.
    json : bool, default False
        Print one JSON object instead of a table.

    Returns
    -------
    int
        Exit code.
    """
    given = {
        "--source": source,
        "--led": led and led[0],
        "--yes": yes,
        "--no-leds": not leds,
        "--loop": loop,
        "--dwell": dwell,
        "--words": words,
        "--baud": baud,
        "--record": record,
    }
    _check_options(given, action, port)
    words = WORDS if words is None else words
    dwell = _DWELL_S if dwell is None else dwell
    if words < 1 or dwell < 0:
        raise DeviceError(f"--words {words} --dwell {dwell:g}: must be at least 1 word and 0 s")
    if action == "skew" and port.startswith(_USB):
        raise DeviceError(f"{port}: is a camera, which has no LEDs; name an illuminator's port")
    if action == "skew":
        return _skew(port, led, yes=yes, baud=baud, record=record, json=json)
    if action == "clock":
        return _clock(port, source, baud=baud, record=record, json=json)
    device = _open(port, baud=baud, record=record)
    tell = partial(_tell, quiet=json)
    try:
        if isinstance(device, Camera):
            results = run_camera_selftest(device, words=words, tell=tell)
        else:
            results = run_illuminator_selftest(
                device, leds=leds, loop=loop, words=words, dwell_s=dwell, tell=tell
            )
    finally:
        device.close()
    passed = all(result.passed for result in results)
    identity = device.identity
    values = {
        "board": f"{identity.board} {identity.serial}, gateware {identity.firmware}",
        "passed": passed,
        "tests": [result.as_dict() for result in results]
        if json
        else f"{sum(result.passed for result in results)} of {len(results)} passed",
    }
    show(f"Self-test of {port}", values, json_wanted=json)
    return 0 if passed else FAILED


def _check_options(given: Mapping[str, object], action: str, port: str) -> None:
    """Refuse options of another action or another kind of board, which would do nothing."""
    for option, value in given.items():
        if value is None or value is False:
            continue
        told = option if value is True else f"{option} {value}"
        if _ACTIONS.get(option, action) != action:
            raise DeviceError(f"{told}: belongs to `hueflight board {_ACTIONS[option]}`")
        if port.startswith(_USB) and option in _ILLUMINATOR:
            raise DeviceError(f"{port}: {told} belongs to illuminators; leave it out")


def _open(port: str, *, baud: int | None, record: Path | None) -> Camera | Illuminator:
    """Open a camera on USB or an illuminator on a serial port."""
    if not port.startswith(_USB):
        return open_illuminator(port, baud=baud, record=record)
    return open_usb_camera(port.removeprefix(_USB))


def _clock(
    port: str, source: ClockName | None, *, baud: int | None, record: Path | None, json: bool
) -> int:
    """Choose a clock, or only show which one is in use."""
    device = _open(port, baud=baud, record=record)
    try:
        state = device.clock() if source is None else device.choose_clock(source)
    finally:
        device.close()
    show(f"Clock of {port}", asdict(state), json_wanted=json)
    return 0


def _skew(
    port: str,
    channels: list[int] | None,
    *,
    yes: bool,
    baud: int | None,
    record: Path | None,
    json: bool,
) -> int:
    """Measure step and skew of the fine delay lines."""
    console = error_console()

    def connect(channel: int) -> None:
        if yes or not console.is_terminal:
            print_notice(f"LED {channel}")
        else:
            console.input(f"Lead the output of LED {channel} to the trigger input; press Enter. ")

    illuminator = open_illuminator(port, baud=baud, record=record)
    try:
        found = measure_skew(illuminator, channels=channels, connect=connect)
    finally:
        illuminator.close()
    measured = {led: skew for led, skew in enumerate(found.skew_ns) if not math.isnan(skew)}
    values: dict[str, Any] = {
        "step_ns": found.step_ns if json else f"{found.step_ns:.4f}",
        "residual_ns": found.residual_ns if json else f"{found.residual_ns:.3f}",
    }
    if json:
        values |= {"skew_ns": [measured.get(led) for led in range(len(found.skew_ns))]}
    else:
        values |= {f"LED {led}, skew_ns": f"{skew:+.3f}" for led, skew in measured.items()}
    show(f"Skew of {port}", values, json_wanted=json)
    return 0


def _tell(result: SelfTestResult, *, quiet: bool) -> None:
    if not quiet:
        verdict = "passed" if result.passed else "FAILED"
        print_notice(f"{result.name}: {verdict}: {result.measured} (bound: {result.bound})")
