# SPDX-License-Identifier: Apache-2.0
"""The ECPIX-5 board with an ECP5-85F or -45F, speed grade 8."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from amaranth.build import Attrs, Pins, Platform, Resource
from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer
from amaranth.lib.wiring import connect
from amaranth_boards.ecpix5 import ECPIX545Platform, ECPIX585Platform

from ..camera.camera import CameraConfig
from ..link.usb import UsbLink
from .ecp5_camera import SYNC_HZ, add_camera, add_clocks, camera_target
from .ecp5_clocks import AIM
from .ecp5_illuminator import illuminator_target
from .pins import drive, input_of
from .sensor_lanes import Ecp5LaneInputs, add_sensor
from .target import Options, Target

# PMODs 0 and 1 lie on the right edge of the device, with the I/O registers for four ticks a clock
_FAST = Attrs(IO_TYPE="LVCMOS33", DRIVE="8", SLEWRATE="FAST", PULLMODE="DOWN")
_PLAIN = Attrs(IO_TYPE="LVCMOS33", PULLMODE="DOWN")
_ILLUMINATOR = [
    # eight pins of PMOD 0 and the first of PMOD 1, by their balls: a resource has one connector
    Resource("led_pulse", 0, Pins("T25 U25 U24 V24 T26 U26 V26 W26 U23", dir="o"), _FAST),
    Resource("trigger", 0, Pins("7", dir="i", conn=("pmod", 1)), _PLAIN),
    Resource("trigger_out", 0, Pins("8", dir="o", conn=("pmod", 1)), _FAST),
    Resource("frame_sync", 0, Pins("9", dir="i", conn=("pmod", 1)), _PLAIN),
    Resource("missed", 0, Pins("10", dir="o", conn=("pmod", 1)), _PLAIN),
    Resource("marker", 0, Pins("1 2 3 4 7 8 9 10", dir="o", conn=("pmod", 2)), _PLAIN),
    Resource("reference", 0, Pins("1", dir="i", conn=("pmod", 3)), _PLAIN),
    Resource("clock_out", 0, Pins("2", dir="o", conn=("pmod", 3)), _FAST),
]
_CAMERA = [
    Resource("trigger", 0, Pins("1", dir="o", conn=("pmod", 1)), _FAST),
    Resource("frame_sync", 0, Pins("2", dir="o", conn=("pmod", 1)), _FAST),
    Resource("missed", 0, Pins("3", dir="i", conn=("pmod", 1)), _PLAIN),
    Resource("marker", 0, Pins("1 2 3 4 7 8 9 10", dir="i", conn=("pmod", 2)), _PLAIN),
    # pins 1 and 2, where the illuminator has its clocks, are the sensor's
    Resource("reference", 0, Pins("3", dir="i", conn=("pmod", 3)), _PLAIN),
    Resource("clock_out", 0, Pins("4", dir="o", conn=("pmod", 3)), _FAST),
    Resource("time_sync", 0, Pins("7", dir="i", conn=("pmod", 3)), _PLAIN),
    Resource("time_sync_out", 0, Pins("8", dir="o", conn=("pmod", 3)), _FAST),
]
# data lanes on PMOD 0, which has nothing else on the camera
_SENSOR = [
    Resource("sensor_data", 0, Pins("1 2 3 4 7 8 9 10", dir="i", conn=("pmod", 0)), _PLAIN),
    Resource("sensor_control", 0, Pins("7", dir="i", conn=("pmod", 1)), _PLAIN),
    Resource("sensor_clock", 0, Pins("8", dir="i", conn=("pmod", 1)), _PLAIN),
    Resource("sensor_expose", 0, Pins("1", dir="o", conn=("pmod", 3)), _FAST),
    Resource("sensor_read", 0, Pins("2", dir="o", conn=("pmod", 3)), _FAST),
]
_SENSOR_LANES = 8
USB_HZ = 60e6
_PHY_CLOCKS = round(1e-3 * SYNC_HZ)
"""A millisecond of reset for the transceiver, and another until it is used."""


_SIZES: dict[str, type[Any]] = {"45f": ECPIX545Platform, "85f": ECPIX585Platform}


def _platform(size: str, resources: list[Resource]) -> Platform:
    platform = _SIZES[size]()
    platform.add_resources(resources)
    return platform


def illuminator(options: Options, size: str) -> Target:
    """Return the illuminator on this board, with an FPGA of a size."""
    return illuminator_target(
        f"ecpix5-{size}",
        lambda: _platform(size, _ILLUMINATOR),
        options,
        armed="rgb_led",
        leds=9,
        edge="right",
    )


class _UsbClock(Elaboratable):
    """Domain `usb`, from the transceiver, and the transceiver's reset."""

    def __init__(self, clock: Signal, reset: Signal) -> None:
        self.clock = clock
        self.reset = reset

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domain to a module, and the logic that generates it."""
        m.domains.usb = usb = ClockDomain()
        platform.add_clock_constraint(usb.clk, USB_HZ * AIM)
        m.submodules.usb_clock = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        left = Signal(range(2 * _PHY_CLOCKS), init=2 * _PHY_CLOCKS - 1)
        waiting = Signal(init=1)
        with m.If(left != 0):
            m.d.sync += left.eq(left - 1)
        m.d.sync += [waiting.eq(left != 0), self.reset.eq(left >= _PHY_CLOCKS)]
        m.submodules.clock = Instance(
            "DCCA", i_CLKI=self.clock, i_CE=Const(1), o_CLKO=ClockSignal("usb")
        )
        m.submodules.reset = ResetSynchronizer(waiting, domain="usb")
        return m


class UsbCamera(Elaboratable):
    """The camera behind USB 2 at high speed, with a sensor on pins or the synthetic one alone."""

    def __init__(self, config: CameraConfig) -> None:
        self.config = config

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        oscillator = platform.request(platform.default_clk, dir="-")
        m.submodules.oscillator = clock = io.Buffer("i", oscillator)
        clocks = add_clocks(m, self.config, platform, clock.i)
        ulpi = platform.request("ulpi", 0, dir="-")
        phy_reset, stop = Signal(init=1), Signal()
        drive(m, "rst", ulpi.rst, phy_reset)
        drive(m, "stp", ulpi.stp, stop)
        _UsbClock(input_of(m, "clk", ulpi.clk), phy_reset).add_to(m, platform)
        m.submodules.data_pins = data = io.Buffer("io", ulpi.data)
        # as LUNA knows it, without a reset: that must not depend on a clock that may stand still
        bus = SimpleNamespace(
            data=data,
            dir=SimpleNamespace(i=input_of(m, "dir", ulpi.dir)),
            nxt=SimpleNamespace(i=input_of(m, "nxt", ulpi.nxt)),
            stp=SimpleNamespace(o=stop),
        )
        camera = add_camera(m, self.config, platform, clocks)
        if self.config.sensor:
            add_sensor(m, camera, platform, Ecp5LaneInputs(clock.i))
        m.submodules.link = link = UsbLink(bus, serial=f"{self.config.serial:08d}")
        connect(m, camera.packets, link.packets)
        connect(m, link.requests, camera.requests)
        connect(m, camera.responses, link.responses)
        return m


def camera(options: Options, size: str) -> Target:
    """Return the camera on this board, with an FPGA of a size."""
    return camera_target(
        f"ecpix5-{size}",
        lambda: _platform(size, [*_CAMERA, *_SENSOR]),
        UsbCamera,
        options,
        link_mhz={"usb": USB_HZ / 1e6},
        sensor_lanes=_SENSOR_LANES,
    )
