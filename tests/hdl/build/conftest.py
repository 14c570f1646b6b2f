# SPDX-License-Identifier: Apache-2.0
"""A board and a design so small that they are built in seconds."""

from collections.abc import Callable

import pytest
from amaranth.build import Attrs, Clock, Pins, Resource
from amaranth.hdl import Cat, ClockDomain, ClockSignal, Elaboratable, Module, Signal
from amaranth.lib.memory import Memory
from amaranth.vendor import LatticeECP5Platform, LatticeICE40Platform

from hueflight_hdl.boards.pins import drive_pin, read_pin
from hueflight_hdl.boards.target import Target


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
