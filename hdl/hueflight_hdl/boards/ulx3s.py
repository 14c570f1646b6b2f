# SPDX-License-Identifier: Apache-2.0
"""The ULX3S board with an ECP5-85F, or a smaller one."""

from __future__ import annotations

from typing import Any

from amaranth.build import Attrs, Pins, Platform, Resource, Subsignal
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module
from amaranth.lib import io
from amaranth.lib.wiring import connect
from amaranth_boards.ulx3s import (
    ULX3S_12F_Platform,
    ULX3S_25F_Platform,
    ULX3S_45F_Platform,
    ULX3S_85F_Platform,
)

from hueflight_protocol.links import FT601_HZ

from ..camera.camera import CameraConfig
from ..link.ft601 import Ft601Link
from ..link.serial import SerialLink
from .ecp5_camera import SYNC_HZ, add_camera, add_clocks, camera_target
from .ecp5_clocks import AIM
from .ecp5_illuminator import illuminator_target
from .pins import drive, input_of
from .target import Options, Target

# the right edge of the device has the I/O registers for four ticks a clock
_FAST = Attrs(IO_TYPE="LVCMOS33", DRIVE="8", SLEWRATE="FAST", PULLMODE="DOWN")
_PLAIN = Attrs(IO_TYPE="LVCMOS33", PULLMODE="DOWN")
_ILLUMINATOR = [
    Resource(
        "led_pulse",
        0,
        Pins("14+ 14- 15+ 15- 16+ 16- 17+ 17- 18+", dir="o", conn=("gpio", 0)),
        _FAST,
    ),
    Resource("trigger", 0, Pins("20+", dir="i", conn=("gpio", 0)), _PLAIN),
    Resource("trigger_out", 0, Pins("21+", dir="o", conn=("gpio", 0)), _FAST),
    Resource("frame_sync", 0, Pins("0+", dir="i", conn=("gpio", 0)), _PLAIN),
    Resource("marker", 0, Pins("1+ 1- 2+ 2- 3+ 3- 4+ 4-", dir="o", conn=("gpio", 0)), _PLAIN),
    Resource("missed", 0, Pins("5+", dir="o", conn=("gpio", 0)), _PLAIN),
    # a pin for clocks, and its neighbor
    Resource("reference", 0, Pins("12+", dir="i", conn=("gpio", 0)), _PLAIN),
    Resource("clock_out", 0, Pins("11+", dir="o", conn=("gpio", 0)), _FAST),
]
_CAMERA = [
    Resource(
        "ft601",
        0,
        Subsignal("clk", Pins("12+", dir="i", conn=("gpio", 0))),
        Subsignal(
            "data",
            Pins(
                " ".join(f"{pair}{sign}" for pair in (*range(9), *range(20, 27)) for sign in "+-"),
                dir="o",
                conn=("gpio", 0),
            ),
        ),
        Subsignal("be", Pins("9+ 9- 10+ 10-", dir="o", conn=("gpio", 0))),
        Subsignal("wr_n", Pins("11+", dir="o", conn=("gpio", 0))),
        Subsignal("rd_n", Pins("11-", dir="o", conn=("gpio", 0))),
        Subsignal("oe_n", Pins("12-", dir="o", conn=("gpio", 0))),
        Subsignal("txe_n", Pins("13+", dir="i", conn=("gpio", 0))),
        _FAST,
    ),
    Resource("trigger", 0, Pins("14+", dir="o", conn=("gpio", 0)), _FAST),
    Resource("frame_sync", 0, Pins("14-", dir="o", conn=("gpio", 0)), _FAST),
    Resource("missed", 0, Pins("15+", dir="i", conn=("gpio", 0)), _PLAIN),
    Resource(
        "marker", 0, Pins("16+ 16- 17+ 17- 18+ 18- 19+ 19-", dir="i", conn=("gpio", 0)), _PLAIN
    ),
    # the FT601 leaves these
    Resource("reference", 0, Pins("13-", dir="i", conn=("gpio", 0)), _PLAIN),
    Resource("clock_out", 0, Pins("15-", dir="o", conn=("gpio", 0)), _FAST),
    Resource("time_sync", 0, Pins("27+", dir="i", conn=("gpio", 0)), _PLAIN),
    Resource("time_sync_out", 0, Pins("27-", dir="o", conn=("gpio", 0)), _FAST),
]
FT_HZ = float(FT601_HZ)
_BAUD = 3e6


_SIZES: dict[str, type[Any]] = {
    "12f": ULX3S_12F_Platform,
    "25f": ULX3S_25F_Platform,
    "45f": ULX3S_45F_Platform,
    "85f": ULX3S_85F_Platform,
}


def _platform(size: str, resources: list[Resource]) -> Platform:
    platform = _SIZES[size]()
    platform.add_resources(resources)
    return platform


def illuminator(options: Options, size: str) -> Target:
    """Return the illuminator on this board, with an FPGA of a size."""
    return illuminator_target(
        f"ulx3s-{size}",
        lambda: _platform(size, _ILLUMINATOR),
        options,
        armed="led",
        leds=9,
        edge="right",
    )


class Ft601Camera(Elaboratable):
    """The camera with a synthetic sensor, an FT601 on the headers and control by serial line.

    The board itself has no transceiver for high-speed USB.
    """

    def __init__(self, config: CameraConfig) -> None:
        self.config = config

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        clocks = add_clocks(m, self.config, platform, clock.i)
        pins = platform.request("ft601", 0, dir="-")
        m.domains.ft = ft = ClockDomain(reset_less=True)
        platform.add_clock_constraint(ft.clk, FT_HZ * AIM)
        m.submodules.link = link = Ft601Link()
        m.submodules.serial = serial = SerialLink(clock_hz=SYNC_HZ, baud=_BAUD)
        m.submodules.ft_clock = Instance(
            "DCCA", i_CLKI=input_of(m, "clk", pins.clk), i_CE=Const(1), o_CLKO=ClockSignal("ft")
        )
        uart = platform.request("uart", 0, dir="-")
        m.d.comb += [
            link.txe_n.eq(input_of(m, "txe_n", pins.txe_n)),
            serial.rx.eq(input_of(m, "rx", uart.rx)),
        ]
        drive(m, "data", pins.data, link.data)
        drive(m, "be", pins.be, link.be)
        drive(m, "wr_n", pins.wr_n, link.wr_n)
        drive(m, "rd_n", pins.rd_n, 1)
        drive(m, "oe_n", pins.oe_n, 1)
        drive(m, "tx", uart.tx, serial.tx)
        camera = add_camera(m, self.config, platform, clocks)
        connect(m, camera.packets, link.packets)
        connect(m, serial.requests, camera.requests)
        connect(m, camera.responses, serial.responses)
        return m


def camera(options: Options, size: str) -> Target:
    """Return the camera on this board, with an FPGA of a size."""
    return camera_target(
        f"ulx3s-{size}",
        lambda: _platform(size, _CAMERA),
        Ft601Camera,
        options,
        link_mhz={"ft": FT_HZ / 1e6},
    )
