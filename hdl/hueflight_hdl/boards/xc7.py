# SPDX-License-Identifier: Apache-2.0
"""The illuminator on Xilinx 7-series boards: four ticks per clock.

# Ref: Xilinx UG472, 7 Series FPGAs Clocking Resources: PLLE2_BASE and BUFGCE.
"""

from __future__ import annotations

from collections.abc import Callable

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib import io
from amaranth.lib.cdc import AsyncFFSynchronizer, FFSynchronizer

from ..common.version import source_hash
from ..illuminator.gearing.xc7 import Xc7Gearing
from ..illuminator.illuminator import IlluminatorConfig
from .illuminator_pins import add_from_platform
from .illuminator_target import target_of
from .pins import drive_pin
from .settings import choose_illuminator
from .target import Options, Target, TargetError

PULSE_HZ = 200e6
CLOCK_RATIO = 4
RECOVERY_CLOCKS = 16
"""Clocks of `sync` after a failure: more than disarming takes to reach the pins."""
_VCO_HZ = (800e6, 1600e6)
"""Range of the PLL's oscillator in the slowest speed grade."""
MUST_MEET_TIMING = (
    "foreach kind {-setup -hold} "
    "{set slack [get_property SLACK [get_timing_paths $kind]]; "
    'if {$slack < 0} {puts stderr "timing is not met: $kind slack $slack ns"; exit 1}}'
)
"""Tcl after routing: a project whose timing fails ends with an error."""


def find_multiplier(clock_hz: float, pulse_hz: float, /) -> int:
    """Return what the PLL multiplies the oscillator by.

    Raises
    ------
    TargetError
        If the PLL cannot make twice, once and a quarter of `pulse_hz`.
    """
    for multiplier in range(2, 65):
        vco = clock_hz * multiplier
        divisions = [vco / (pulse_hz * factor) for factor in (2, 1, 1 / CLOCK_RATIO)]
        exact = all(abs(division - round(division)) < 1e-9 for division in divisions)
        if _VCO_HZ[0] <= vco <= _VCO_HZ[1] and exact:
            return multiplier
    raise TargetError(
        f"pulse_hz = {pulse_hz:g}: the PLL cannot make it from a clock of {clock_hz:g} Hz, "
        "with an oscillator of 800 to 1600 MHz that is a multiple of both"
    )


class Xc7Clocks(Elaboratable):
    """Domains `edge` (twice `pulse`), `pulse` and `sync` (a quarter of `pulse`).

    All clocks are stopped until the PLL has locked, so that every register leaves its configured
    value on the same clean edge.

    Parameters
    ----------
    clock : Signal
        From the oscillator.
    clock_hz, pulse_hz : float
        Frequencies of the oscillator and of the domain `pulse`.

    Attributes
    ----------
    failed : Signal
        High while the PLL has not locked and for `RECOVERY_CLOCKS` after. It rises without a
        clock, from a preset of flip-flops.
    io_reset : Signal
        Resets the I/O serialisers; it falls with a clock of `pulse`.
    """

    def __init__(self, clock: Signal, clock_hz: float, pulse_hz: float) -> None:
        self.clock = clock
        self.clock_hz = clock_hz
        self.pulse_hz = pulse_hz
        self.failed = Signal(init=1)
        self.io_reset = Signal(init=1)

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them.

        The vendor's tool derives the constraints of the PLL's outputs from the oscillator's.
        """
        for name in ("edge", "pulse", "sync"):
            m.domains += ClockDomain(name, reset_less=True)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        multiplier = find_multiplier(self.clock_hz, self.pulse_hz)
        vco = self.clock_hz * multiplier
        feedback, locked, running = Signal(), Signal(), Signal()
        raw = {name: Signal(name=f"raw_{name}") for name in ("edge", "pulse", "sync")}
        made = {"edge": 2 * self.pulse_hz, "pulse": self.pulse_hz}
        made["sync"] = self.pulse_hz / CLOCK_RATIO
        m.submodules.pll = Instance(
            "PLLE2_BASE",
            p_CLKIN1_PERIOD=1e9 / self.clock_hz,
            p_CLKFBOUT_MULT=multiplier,
            p_DIVCLK_DIVIDE=1,
            **{
                f"p_CLKOUT{number}_DIVIDE": round(vco / made[name])
                for number, name in enumerate(raw)
            },
            i_CLKIN1=self.clock,
            i_CLKFBIN=feedback,
            i_RST=Const(0),
            i_PWRDWN=Const(0),
            o_CLKFBOUT=feedback,
            o_LOCKED=locked,
            **{f"o_CLKOUT{number}": signal for number, signal in enumerate(raw.values())},
        )
        m.domains.free = free = ClockDomain(local=True, reset_less=True)
        m.submodules.free = Instance("BUFG", i_I=raw["sync"], o_O=free.clk)
        m.submodules.running = FFSynchronizer(locked, running, o_domain="free", stages=3)
        for name, signal in raw.items():
            m.submodules[f"{name}_gate"] = Instance(
                "BUFGCE", i_I=signal, i_CE=running, o_O=ClockSignal(name)
            )
        m.submodules.failed = AsyncFFSynchronizer(
            ~locked, self.failed, o_domain="sync", stages=RECOVERY_CLOCKS
        )
        m.submodules.io_reset = AsyncFFSynchronizer(
            ~locked, self.io_reset, o_domain="pulse", stages=4
        )
        return m


class Xc7Illuminator(Elaboratable):
    """Top-level module of the illuminator on a 7-series board.

    Parameters
    ----------
    config : IlluminatorConfig
        What is built.
    armed : str
        Resource of the indicator LED that is lit while the board is armed.
    """

    def __init__(self, config: IlluminatorConfig, /, *, armed: str) -> None:
        self.config = config
        self.armed = armed

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        clocks = Xc7Clocks(clock.i, platform.default_clk_frequency, self.config.pulse_hz)
        clocks.add_to(m, platform)
        gearing = Xc7Gearing(clocks.io_reset)
        illuminator = add_from_platform(m, self.config, gearing, platform, clocks.failed)
        drive_pin(m, platform, self.armed, illuminator.armed)
        return m


def illuminator_target(
    board: str,
    platform: Callable[[], Platform],
    options: Options,
    /,
    *,
    armed: str,
    leds: int,
    pulse_hz: float,
) -> Target:
    """Return the illuminator on a 7-series board.

    Parameters
    ----------
    board : str
        Name of the board.
    platform : callable
        Returns the platform with all pins.
    options : Options
        Choices of the user.
    armed : str
        Resource of the indicator LED.
    leds : int
        Pins that the board has for LEDs.
    pulse_hz : float
        Frequency of the domain `pulse`; a tick is a quarter of its clock.

    Returns
    -------
    Target
        What can be written as a project for Vivado.
    """
    find_multiplier(platform().default_clk_frequency, pulse_hz)
    base = IlluminatorConfig(
        pulse_hz=pulse_hz,
        clock_ratio=CLOCK_RATIO,
        source=source_hash(),
        memory_style="distributed",
    )
    config = choose_illuminator(base, options, board=board, leds=leds)
    return target_of(
        config,
        lambda: Xc7Illuminator(config, armed=armed),
        board=board,
        platform=platform,
        family="xc7",
        options={"script_before_bitstream": MUST_MEET_TIMING},
    )
