# SPDX-License-Identifier: Apache-2.0
"""Opal Kelly XEM3010, the illuminator board of the paper: a project for Xilinx ISE.

Its pins are not published in a document that could be cited, so the user names them (see
`pin_file`). Control uses a serial line on two of them, not the vendor's host interface.

# Ref: Xilinx DS099, Spartan-3 FPGA Family; UG331, chapter 3, DCM.
"""

from __future__ import annotations

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib import io
from amaranth.vendor import XilinxPlatform

from ..common.version import source_hash
from ..illuminator.gearing.portable import DoubleDataRateGearing
from ..illuminator.illuminator import IlluminatorConfig
from ..illuminator.pulse_generator.config import Limits, PulseConfig
from .illuminator_pins import GearedPorts, add_illuminator
from .illuminator_target import target_of
from .pin_file import PinFile, read_pins
from .pins import drive_pin, read_pin
from .settings import choose_illuminator
from .target import Options, Target

WIRED = {
    "clock": 1,
    "rx": 1,
    "tx": 1,
    "trigger": 1,
    "trigger_out": 1,
    "frame_sync": 1,
    "armed": 1,
    "led_pulse": 9,
    "marker": 8,
    "missed": 1,
}
"""Pins that the builder names, and how many each."""


class Xem3010Platform(XilinxPlatform):
    """The board's FPGA."""

    device = "xc3s1500"
    package = "fg320"
    speed = "4"
    default_clk = "clock"
    connectors = ()
    resources = ()

    def __init__(self) -> None:
        super().__init__(toolchain="ISE")


def xem3010_config(pulse_hz: float) -> IlluminatorConfig:
    """Return the configuration: two ticks a clock; limits of 100 ns at 100 MHz."""
    pulse = PulseConfig(lanes=2, limits=Limits(max_on_ticks=20, duty_divisor=8, burst_ticks=20))
    return IlluminatorConfig(
        pulse=pulse,
        pulse_hz=pulse_hz,
        clock_ratio=2,
        baud=1e6,
        source=source_hash(),
        clock_supervision=False,
    )


class _Clocks(Elaboratable):
    """Domains `pulse`, as the oscillator, and `sync`, half of it."""

    def __init__(self, clock: Signal, clock_hz: float) -> None:
        self.clock = clock
        self.clock_hz = clock_hz

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        for name, frequency in (("pulse", self.clock_hz), ("sync", self.clock_hz / 2)):
            m.domains += (domain := ClockDomain(name, reset_less=True))
            platform.add_clock_constraint(domain.clk, frequency)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        whole, half = Signal(), Signal()
        for name, raw in (("pulse", whole), ("sync", half)):
            m.submodules[f"{name}_buffer"] = Instance("BUFG", i_I=raw, o_O=ClockSignal(name))
        m.submodules.dcm = Instance(
            "DCM",
            p_CLKDV_DIVIDE="2.0",
            p_CLK_FEEDBACK="1X",
            i_CLKIN=self.clock,
            i_CLKFB=ClockSignal("pulse"),
            i_RST=Const(0),
            o_CLK0=whole,
            o_CLKDV=half,
        )
        return m


class _Top(Elaboratable):
    def __init__(self, config: IlluminatorConfig, clock_hz: float) -> None:
        self.config = config
        self.clock_hz = clock_hz

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        m.submodules.oscillator = clock = io.Buffer("i", platform.request("clock", 0, dir="-"))
        _Clocks(clock.i, self.clock_hz).add_to(m, platform)
        config = self.config
        pulses = platform.request("led_pulse", 0, dir="-")
        ports = GearedPorts(
            trigger=platform.request("trigger", 0, dir="-"),
            channels=tuple(pulses[channel] for channel in range(config.pulse.channels)),
            trigger_out=platform.request("trigger_out", 0, dir="-"),
        )
        illuminator = add_illuminator(m, config, DoubleDataRateGearing(own_sampler=True), ports)
        m.d.comb += [
            illuminator.rx.eq(read_pin(m, platform, "rx")),
            illuminator.frame_sync.eq(read_pin(m, platform, "frame_sync")),
        ]
        for name in ("tx", "marker", "missed", "armed"):
            drive_pin(m, platform, name, getattr(illuminator, name))
        return m


def _platform(pins: PinFile) -> Platform:
    platform = Xem3010Platform()
    inputs = ("clock", "rx", "trigger", "frame_sync")
    platform.add_resources(pins.resource(name, "i" if name in inputs else "o") for name in WIRED)
    return platform


def illuminator(options: Options) -> Target:
    """Return the illuminator on this board."""
    pins = read_pins(options.pins, "xem3010", WIRED)
    clock_hz = pins.clock_hz or 0.0
    config = choose_illuminator(xem3010_config(clock_hz), options, board="xem3010", leds=9)
    return target_of(
        config,
        lambda: _Top(config, clock_hz),
        board="xem3010",
        platform=lambda: _platform(pins),
        family="xc3s",
    )
