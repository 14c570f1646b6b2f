# SPDX-License-Identifier: Apache-2.0
"""A board and a design so small that they are built in seconds."""

from collections.abc import Callable

import pytest
from amaranth.build import Attrs, Clock, Pins, Resource
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Module, Signal
from amaranth.vendor import LatticeICE40Platform

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


@pytest.fixture
def small() -> Callable[..., Target]:
    """Function that returns a target whose clock is asked to reach so many MHz."""

    def make(mhz: float) -> Target:
        return Target("illuminator", "small", SmallPlatform, Blink, {"sync": mhz}, "ice40")

    return make
