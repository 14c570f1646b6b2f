# SPDX-License-Identifier: Apache-2.0
"""The illuminator on any ECP5 board: nine channels in ticks of 1.25 ns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from amaranth.build import Platform
from amaranth.hdl import Elaboratable, Module, Signal
from amaranth.lib import io

from ..common.version import source_hash
from ..illuminator.gearing.ecp5 import DelayLine, Ecp5Gearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import PulseConfig
from .ecp5_clocks import CLOCK_RATIO, PULSE_HZ, Ecp5Clocks, check_clocks
from .ecp5_pll import pll_place
from .ecp5_reference import conversion, reference_from_pins
from .ecp5_temperature import add_temperature
from .illuminator_pins import add_from_platform
from .illuminator_target import target_of
from .pins import drive
from .settings import choose_illuminator
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
    armed : str
        Resource of the indicator LED that is lit while the board is armed; of ``rgb_led`` the red
        one is.
    edge : {"left", "right"}, optional
        Edge of the device with the LEDs, for boards with an external clock.
    """

    def __init__(
        self, config: IlluminatorConfig, /, *, armed: str, edge: str | None = None
    ) -> None:
        self.armed = armed
        self.edge = edge
        self.config = config

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        clock_hz = platform.default_clk_frequency
        reference = None
        if self.config.reference_hz:
            assert self.edge is not None  # illuminator_target has refused it
            place = pll_place(platform.device, self.edge)
            reference = reference_from_pins(
                m, platform, clock.i, self.config.reference_hz, place=place
            )
        clocks = Ecp5Clocks(clock.i, clock_hz, pulse_hz=self.config.pulse_hz, reference=reference)
        clocks.add_to(m, platform)
        channels = range(self.config.pulse.channels if self.config.fine_steps else 0)
        lines = [DelayLine(Signal(), Signal()) for _ in channels]
        delays = {f"channel{channel}": line for channel, line in enumerate(lines)}
        gearing = Ecp5Gearing(clocks.io_reset, delays=delays)
        illuminator = add_from_platform(m, self.config, gearing, platform, clocks.failed)
        m.d.comb += illuminator.temperature.eq(add_temperature(m, self.config.sync_hz))
        for channel, line in enumerate(lines):
            m.d.comb += [
                line.load.eq(illuminator.fine_load),
                line.move.eq(illuminator.fine_move[channel]),
            ]
        if reference is not None:
            m.d.comb += [
                reference.wanted.eq(illuminator.reference_wanted),
                illuminator.reference_state.eq(reference.state),
            ]
        lamp = platform.request(self.armed, 0, dir="-")
        drive(m, "armed", lamp.r if self.armed == "rgb_led" else lamp, illuminator.armed)
        return m


def illuminator_target(
    board: str,
    platform: Callable[[], Platform],
    options: Options,
    /,
    *,
    armed: str,
    leds: int,
    pulse_hz: float = PULSE_HZ,
    edge: str | None = None,
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
    armed : str
        See `Ecp5Illuminator`.
    leds : int
        Pins that the board has for LEDs.
    pulse_hz : float
        Frequency of the domain `pulse`; a tick is a quarter of its clock.
    edge : {"left", "right"}, optional
        See `Ecp5Illuminator`; without it there is no external clock.

    Returns
    -------
    Target
        What can be built.

    Raises
    ------
    TargetError
        If the clocks cannot be made, or there are more channels than pins.
    """
    made = platform()
    check_clocks(made.default_clk_frequency, pulse_hz)
    config = choose_illuminator(
        replace(ecp5_config(pulse_hz=pulse_hz), temperature=True),
        options,
        board=board,
        leds=leds,
        external_clock=edge is not None and ("reference", 0) in made.resources,
        fine_delay=True,
    )
    if config.reference_hz:
        conversion(round(made.default_clk_frequency), config.reference_hz)
    return target_of(
        config,
        lambda: Ecp5Illuminator(config, armed=armed, edge=edge),
        board=board,
        platform=platform,
        family="ecp5",
        options=FAST_ROUTES,
    )
