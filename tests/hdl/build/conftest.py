# SPDX-License-Identifier: Apache-2.0
"""A board and a design so small that they are built in seconds."""

from collections.abc import Callable

import pytest
from amaranth.build import Attrs, Clock, Pins, Resource
from amaranth.hdl import Cat, ClockDomain, ClockSignal, Elaboratable, Module, Signal
from amaranth.lib.memory import Memory
from amaranth.vendor import LatticeECP5Platform, LatticeICE40Platform

from hueflight_hdl.boards.ecp5_clocks import Ecp5Clocks
from hueflight_hdl.boards.ecp5_pll import pll_place
from hueflight_hdl.boards.ecp5_reference import Ecp5Reference, clock_output
from hueflight_hdl.boards.pins import drive_pin, read_pin
from hueflight_hdl.boards.target import Target
from hueflight_hdl.illuminator.gearing.ecp5 import DelayLine, Ecp5Gearing


class SmallPlatform(LatticeICE40Platform):
    device = "iCE40HX8K"
    package = "CT256"
    default_clk = "clock"
    connectors = ()
    resources = (
        Resource("clock", 0, Pins("J3", dir="i"), Clock(12e6), Attrs(GLOBAL=True)),
        Resource("lamp", 0, Pins("B5", dir="o")),
    )


class Blink(Elaboratable):
    def elaborate(self, platform):
        m = Module()
        m.domains.sync = domain = ClockDomain(reset_less=True)
        platform.add_clock_constraint(domain.clk, 12e6)
        m.d.comb += ClockSignal().eq(read_pin(m, platform, "clock"))
        count = Signal(24)
        m.d.sync += count.eq(count + 1)
        drive_pin(m, platform, "lamp", count[-1])
        return m


class SmallEcp5Platform(LatticeECP5Platform):
    device = "LFE5U-12F"
    package = "BG381"
    speed = "6"
    default_clk = "clock"
    connectors = ()
    resources = (
        Resource("clock", 0, Pins("G2", dir="i"), Clock(25e6), Attrs(IO_TYPE="LVCMOS33")),
        Resource("lamp", 0, Pins("B2", dir="o"), Attrs(IO_TYPE="LVCMOS33")),
    )


class TwoEdgesPlatform(LatticeECP5Platform):
    device = "LFE5U-12F"
    package = "BG256"
    speed = "6"
    default_clk = "clock"
    connectors = ()
    resources = (
        Resource("clock", 0, Pins("P6", dir="i"), Clock(25e6), Attrs(IO_TYPE="LVCMOS33")),
        Resource("lamp", 0, Pins("A8", dir="o"), Attrs(IO_TYPE="LVCMOS33")),
        Resource("reference", 0, Pins("K1", dir="i"), Attrs(IO_TYPE="LVCMOS33")),
        Resource("left", 0, Pins("C1", dir="o"), Attrs(IO_TYPE="LVCMOS33")),
        Resource("right", 0, Pins("P11", dir="o"), Attrs(IO_TYPE="LVCMOS33")),
    )


class FinePlatform(TwoEdgesPlatform):
    resources = (
        TwoEdgesPlatform.resources[0],
        Resource("lamp", 0, Pins("K1", dir="o"), Attrs(IO_TYPE="LVCMOS33")),
        Resource("left", 0, Pins("C1", dir="o"), Attrs(IO_TYPE="LVCMOS33")),
    )


class TwoEdges(Elaboratable):
    """Geared outputs on both edges of the device."""

    def elaborate(self, platform):
        m = Module()
        clocks = Ecp5Clocks(read_pin(m, platform, "clock"), 25e6, pulse_hz=100e6)
        clocks.add_to(m, platform)
        count = Signal(4)
        lamp = Signal()
        m.d.pulse += count.eq(count + 1)
        m.d.sync += lamp.eq(~lamp)
        drive_pin(m, platform, "lamp", lamp)
        for name in ("left", "right"):
            Ecp5Gearing().add_output(m, name, platform.request(name, 0, dir="-"), count)
        return m


class TwoClocks(Elaboratable):
    """The clocks of an illuminator that may run from 10 MHz, and a counter."""

    def elaborate(self, platform):
        m = Module()
        oscillator = read_pin(m, platform, "clock")
        external = read_pin(m, platform, "reference")
        place = pll_place(platform.device, "left")
        reference = Ecp5Reference(oscillator, 25_000_000, external, 10_000_000, place=place)
        Ecp5Clocks(oscillator, 25e6, reference=reference).add_to(m, platform)
        out, lamp, count = Signal(), Signal(), Signal(4)
        clock_output(m, reference.chosen, out)
        m.d.pulse += count.eq(count + 1)
        m.d.sync += lamp.eq(reference.state.as_value().any())
        m.d.comb += reference.wanted.eq(lamp)
        drive_pin(m, platform, "right", out)
        drive_pin(m, platform, "lamp", lamp)
        Ecp5Gearing().add_output(m, "left", platform.request("left", 0, dir="-"), count)
        return m


class FineOutputs(Elaboratable):
    """A geared output with a fine delay line that moves, and one whose line stays at 0."""

    def elaborate(self, platform):
        m = Module()
        clocks = Ecp5Clocks(read_pin(m, platform, "clock"), 25e6, pulse_hz=100e6)
        clocks.add_to(m, platform)
        count, moves = Signal(4), Signal(4)
        m.d.pulse += count.eq(count + 1)
        m.d.sync += moves.eq(moves + 1)
        gearing = Ecp5Gearing(clocks.io_reset, delays={"left": DelayLine(moves[3], moves[1])})
        for name in ("left", "lamp"):
            port = platform.request(name, 0, dir="-")
            gearing.add_output(m, name, port, count, enable=~clocks.failed)
        return m


class Constants(Elaboratable):
    """A memory that shows its content, one bit after another."""

    def __init__(self, content: list[int]):
        self.content = content

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = domain = ClockDomain(reset_less=True)
        platform.add_clock_constraint(domain.clk, 12e6)
        m.d.comb += ClockSignal().eq(read_pin(m, platform, "clock"))
        m.submodules.store = store = Memory(shape=32, depth=512, init=self.content)
        port, save = store.read_port(), store.write_port()
        count = Signal(14)
        m.d.sync += count.eq(count + 1)
        m.d.comb += [port.addr.eq(count[5:]), save.addr.eq(count[3:]), save.en.eq(count.all())]
        m.d.comb += save.data.eq(Cat(count, ~count, count))
        drive_pin(m, platform, "lamp", port.data.bit_select(count[:5], 1))
        return m


@pytest.fixture(params=["ice40", "ecp5"])
def with_constants(request: pytest.FixtureRequest) -> Callable[..., Target]:
    """Function that returns a target with a memory of some content, for each family."""
    platform = {"ice40": SmallPlatform, "ecp5": SmallEcp5Platform}[request.param]

    def make(content: list[int]) -> Target:
        top = Constants(content)
        return Target("illuminator", "small", platform, lambda: top, {"sync": 12}, request.param)

    return make


@pytest.fixture
def small() -> Callable[..., Target]:
    """Function that returns a target whose clock is asked to reach so many MHz."""

    def make(mhz: float) -> Target:
        return Target("illuminator", "small", SmallPlatform, Blink, {"sync": mhz}, "ice40")

    return make


@pytest.fixture
def two_edges() -> Target:
    """A target whose geared pins are on both edges of the device."""
    return Target("illuminator", "small", TwoEdgesPlatform, TwoEdges, {"pulse": 100.0}, "ecp5")


@pytest.fixture
def two_clocks() -> Target:
    """A target that chooses between two clocks."""
    return Target("illuminator", "small", TwoEdgesPlatform, TwoClocks, {"pulse": 200.0}, "ecp5")


@pytest.fixture
def fine_outputs() -> Target:
    """Target with fine delay lines on its outputs."""
    return Target(
        "illuminator", "small", FinePlatform, FineOutputs, {"pulse": 100, "sync": 25}, "ecp5"
    )
