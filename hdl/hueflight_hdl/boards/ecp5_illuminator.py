# SPDX-License-Identifier: Apache-2.0
"""The illuminator on any ECP5 board: nine channels in ticks of 1.25 ns."""

from __future__ import annotations

from collections.abc import Callable

from amaranth.build import Platform
from amaranth.hdl import Elaboratable, Module
from amaranth.lib import io

from ..common.version import source_hash
from ..illuminator.gearing.ecp5 import Ecp5Gearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import PulseConfig
from .ecp5_clocks import CLOCK_RATIO, PULSE_HZ, Ecp5Clocks
from .illuminator_pins import add_from_platform
from .pins import drive
from .settings import choose_illuminator, illuminator_settings
from .target import Options, Target

FAST_ROUTES = {
    # keeps yosys from merging equal registers of channels into nets that span the device
    "script_after_read": (
        "setattr -mod -set keep_hierarchy 1 *.channel? *.channel?? *.generator.trigger_out*"
    ),
    # and from making resets of choices there: those are the slowest wires
    "synth_opts": "-run begin:map_ffs",
    "script_after_synth": (
        "dffunmap -srst-only *.channel? *.channel?? *.generator.trigger_out*; "
        "synth_ecp5 -run map_ffs: -top top"
    ),
}


def ecp5_config(
    pulse: PulseConfig | None = None, *, pulse_hz: float = PULSE_HZ
) -> IlluminatorConfig:
    """Return the configuration of the illuminator on ECP5.

    The sequencer's memory is made of LUTs: block memory needs more than a clock of `pulse`.
    """
    return IlluminatorConfig(
        pulse=pulse or PulseConfig(),
        pulse_hz=pulse_hz,
        clock_ratio=CLOCK_RATIO,
        source=source_hash(),
        memory_style="distributed",
    )


class Ecp5Illuminator(Elaboratable):
    """Top-level module of the illuminator on an ECP5 board.

    Parameters
    ----------
    config : IlluminatorConfig
        What is built.
    armed : tuple of str and int
        Resource of the indicator LED that is lit while the board is armed.
    """

    def __init__(self, config: IlluminatorConfig, /, *, armed: tuple[str, int]) -> None:
        self.armed = armed
        self.config = config

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        clocks = Ecp5Clocks(clock.i, platform.default_clk_frequency, pulse_hz=self.config.pulse_hz)
        clocks.add_to(m, platform)
        gearing = Ecp5Gearing(clocks.io_reset)
        illuminator = add_from_platform(m, self.config, gearing, platform, clocks.failed)
        lamp = platform.request(*self.armed, dir="-")
        drive(m, "armed", lamp.r if self.armed[0] == "rgb_led" else lamp, illuminator.armed)
        return m


def illuminator_target(
    board: str,
    platform: Callable[[], Platform],
    options: Options,
    /,
    *,
    armed: tuple[str, int],
    leds: int,
    pulse_hz: float = PULSE_HZ,
) -> Target:
    """Return the illuminator on an ECP5 board.

    Parameters
    ----------
    board : str
        Name of the board.
    platform : callable
        Returns the platform with all pins.
    options : Options
        Choices of the user.
    armed : tuple of str and int
        See `Ecp5Illuminator`.
    leds : int
        Pins that the board has for LEDs.
    pulse_hz : float
        Frequency of the domain `pulse`; a tick is a quarter of its clock.

    Returns
    -------
    Target
        What can be built.
    """
    config = choose_illuminator(ecp5_config(pulse_hz=pulse_hz), options, board=board, leds=leds)
    return Target(
        design="illuminator",
        board=board,
        platform=platform,
        top=lambda: Ecp5Illuminator(config, armed=armed),
        clocks_mhz={"pulse": config.pulse_hz / 1e6, "sync": config.sync_hz / 1e6},
        family="ecp5",
        options=FAST_ROUTES,
        settings=illuminator_settings(config),
    )
