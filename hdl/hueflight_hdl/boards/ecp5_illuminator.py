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
from .ecp5_clocks import PULSE_HZ, SYNC_HZ, Ecp5Clocks
from .illuminator_pins import add_from_platform
from .pins import drive
from .target import Target

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


def ecp5_config(pulse: PulseConfig | None = None) -> IlluminatorConfig:
    """Return the configuration of the illuminator on ECP5.

    The sequencer's memory is made of LUTs: block memory needs more than a clock of `pulse`.
    """
    return IlluminatorConfig(
        pulse=pulse or PulseConfig(),
        pulse_hz=PULSE_HZ,
        clock_ratio=round(PULSE_HZ / SYNC_HZ),
        source=source_hash(),
        memory_style="distributed",
    )


class Ecp5Illuminator(Elaboratable):
    """Top-level module of the illuminator on an ECP5 board.

    Parameters
    ----------
    armed : tuple of str and int
        Resource of the indicator LED that is lit while the board is armed.
    """

    def __init__(self, *, armed: tuple[str, int]) -> None:
        self.armed = armed
        self.config = ecp5_config()

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        clocks = Ecp5Clocks(clock.i, platform.default_clk_frequency)
        clocks.add_to(m, platform)
        gearing = Ecp5Gearing(clocks.io_reset)
        illuminator = add_from_platform(m, self.config, gearing, platform, clocks.failed)
        lamp = platform.request(*self.armed, dir="-")
        drive(m, "armed", lamp.r if self.armed[0] == "rgb_led" else lamp, illuminator.armed)
        return m


def illuminator_target(
    board: str, platform: Callable[[], Platform], /, *, armed: tuple[str, int]
) -> Target:
    """Return the illuminator on an ECP5 board; `armed` is as `Ecp5Illuminator` has it."""
    return Target(
        design="illuminator",
        board=board,
        platform=platform,
        top=lambda: Ecp5Illuminator(armed=armed),
        clocks_mhz={"pulse": PULSE_HZ / 1e6, "sync": SYNC_HZ / 1e6},
        family="ecp5",
        options=FAST_ROUTES,
    )
