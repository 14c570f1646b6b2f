# SPDX-License-Identifier: Apache-2.0
"""iCE40-HX8K breakout board: two ticks of 4.975 ns a clock."""

from __future__ import annotations

from amaranth.build import Attrs, Pins, Platform, Resource
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer
from amaranth_boards.ice40_hx8k_b_evn import ICE40HX8KBEVNPlatform

from ..common.version import source_hash
from ..illuminator.gearing.portable import DoubleDataRateGearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import Limits, PulseConfig
from .illuminator_pins import add_from_platform
from .pins import drive_pin
from .target import Options, Target

PULSE_HZ = 100.5e6
"""12 MHz · 67 / 8: the PLL has no 100 MHz."""
_AIM = 1.15

_PLAIN = Attrs(IO_STANDARD="SB_LVCMOS")
_RESOURCES = [
    # connector J2, from its beginning
    Resource("led_pulse", 0, Pins("R15 P16 P15 N16 M15 M16 L16 K15 K16", dir="o"), _PLAIN),
    Resource("trigger", 0, Pins("K14", dir="i"), _PLAIN),
    Resource("trigger_out", 0, Pins("J14", dir="o"), _PLAIN),
    Resource("frame_sync", 0, Pins("G14", dir="i"), _PLAIN),
    Resource("marker", 0, Pins("F14 J15 H14 H16 G15 G16 F15 F16", dir="o"), _PLAIN),
    Resource("missed", 0, Pins("E14", dir="o"), _PLAIN),
]


def hx8k_config() -> IlluminatorConfig:
    """Return the configuration: two pulses per channel, and limits of 100 ns."""
    pulse = PulseConfig(
        pulses=2, lanes=2, limits=Limits(max_on_ticks=20, duty_divisor=8, burst_ticks=20)
    )
    return IlluminatorConfig(
        pulse=pulse,
        pulse_hz=PULSE_HZ,
        clock_ratio=2,
        source=source_hash(),
        clock_supervision=False,
    )


class _Clocks(Elaboratable):
    """Domains `pulse` (100.5 MHz) and `sync` (half of it), in reset until the PLL has locked.

    # Ref: Lattice FPGA-TN-02052, iCE40 sysCLOCK PLL.
    """

    def __init__(self, clock: Signal) -> None:
        self.clock = clock

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        for name, frequency in (("pulse", PULSE_HZ), ("sync", PULSE_HZ / 2)):
            domain = ClockDomain(name)
            m.domains += domain
            platform.add_clock_constraint(domain.clk, frequency * _AIM)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        locked = Signal()
        for name in ("pulse", "sync"):
            m.submodules[f"{name}_reset"] = ResetSynchronizer(~locked, domain=name)
        m.submodules.pll = Instance(
            "SB_PLL40_2F_CORE",
            p_FEEDBACK_PATH="SIMPLE",
            p_DIVR=Const(0, 4),
            p_DIVF=Const(66, 7),
            p_DIVQ=Const(3, 3),
            p_FILTER_RANGE=Const(1, 3),
            p_PLLOUT_SELECT_PORTA="GENCLK",
            p_PLLOUT_SELECT_PORTB="GENCLK_HALF",
            i_REFERENCECLK=self.clock,
            i_RESETB=Const(1),
            i_BYPASS=Const(0),
            o_PLLOUTGLOBALA=ClockSignal("pulse"),
            o_PLLOUTGLOBALB=ClockSignal("sync"),
            o_LOCK=locked,
        )
        return m


class _Top(Elaboratable):
    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        _Clocks(clock.i).add_to(m, platform)
        illuminator = add_from_platform(m, hx8k_config(), DoubleDataRateGearing(), platform)
        drive_pin(m, platform, "led", illuminator.armed)
        return m


def _platform() -> Platform:
    platform = ICE40HX8KBEVNPlatform()
    platform.add_resources(_RESOURCES)
    return platform


_NO_ENABLES = {"synth_opts": "-nodffe"}
"""Eight logic cells share an enable; hundreds of small groups of registers would not fit."""


def illuminator(options: Options) -> Target:
    """Return the illuminator on this board."""
    return Target(
        design="illuminator",
        board="hx8k",
        platform=_platform,
        top=_Top,
        clocks_mhz={"pulse": PULSE_HZ / 1e6, "sync": PULSE_HZ / 2e6},
        family="ice40",
        options=_NO_ENABLES,
    )
