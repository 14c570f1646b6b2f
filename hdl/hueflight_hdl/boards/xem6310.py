# SPDX-License-Identifier: Apache-2.0
"""Opal Kelly XEM6310-LX150, the camera board of the paper: a project for Xilinx ISE.

# Ref: pins of the host interface, clock and lamps: Opal Kelly, design-resources,
# ExampleProjects/Camera/HDL/XEM6310/xem6310.ucf. What is wired to the illuminator is named by
# the builder (see `pin_file`).
"""

from __future__ import annotations

from amaranth.build import Attrs, Clock, DiffPairs, Pins, Platform, Resource
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Module
from amaranth.lib import io
from amaranth.lib.wiring import connect
from amaranth.vendor import XilinxPlatform

from hueflight_protocol.links import OPAL_KELLY_HZ

from ..camera.camera import CameraConfig
from ..link.opal_kelly import BLACKBOXES, OpalKellyLink, OpalKellyPins
from .ecp5_camera import SYNC_HZ, add_camera, camera_config
from .pin_file import PinFile, read_pins
from .sensor_lanes import (
    HOLD_NS,
    SENSOR_HZ,
    SETUP_NS,
    PortableLaneInputs,
    add_sensor,
    check_lanes,
)
from .settings import camera_settings, refuse_reference
from .target import Options, Target

OK_HZ = float(OPAL_KELLY_HZ)
_HOST = Attrs(IOSTANDARD="LVCMOS18")
_FAST_HOST = Attrs(IOSTANDARD="LVCMOS18", SLEW="FAST")
_UHU = (
    "AB12 AA12 Y13 AB18 AA18 V15 AB2 AA2 Y7 Y4 W4 AB6 AA6 U13 U14 AA20 "
    "T16 AA10 U16 Y15 R15 U17 AA14 T15 T10 Y17 AA16 R16 V9 AB15 Y5 U8"
)
WIRED = {"trigger": 1, "frame_sync": 1, "missed": 1, "marker": 8}
"""Pins that the builder names, and how many each."""
SENSOR_LANES = 8
IO_TIMING = "\n".join(
    f'OFFSET = IN {SETUP_NS} ns VALID {SETUP_NS + HOLD_NS:g} ns BEFORE "sensor_clock_0__io" {edge};'
    for edge in ("RISING", "FALLING")
)
"""Constraints of the sensor's pins: bits are valid around both edges of its clock."""


def wired(config: CameraConfig, /) -> dict[str, int]:
    """Return the pins that the builder names for a camera, and how many each."""
    if not config.sensor:
        return WIRED
    single = dict.fromkeys(("sensor_clock", "sensor_control", "sensor_expose", "sensor_read"), 1)
    return {**WIRED, "sensor_data": config.form.lanes, **single}


class Xem6310Platform(XilinxPlatform):
    """The board, with the pins that its maker has published."""

    device = "xc6slx150"
    package = "fgg484"
    speed = "2"
    default_clk = "clk100"
    connectors = ()
    resources = (
        Resource(
            "clk100",
            0,
            DiffPairs("Y11", "AB11", dir="i"),
            Clock(100e6),
            Attrs(IOSTANDARD="LVDS_25"),
        ),
        Resource("ok_uh", 0, Pins("Y12 AA4 AB3 Y6 AB21", dir="i"), _HOST),
        Resource("ok_hu", 0, Pins("AA8 U10 AB5", dir="o"), _FAST_HOST),
        Resource("ok_uhu", 0, Pins(_UHU, dir="io"), _FAST_HOST),
        Resource("ok_aa", 0, Pins("W11", dir="io"), _HOST),
    )

    def __init__(self) -> None:
        super().__init__(toolchain="ISE")


class OpalKellyCamera(Elaboratable):
    """The camera behind Opal Kelly's host interface, with a sensor on pins or the synthetic one."""

    def __init__(self, config: CameraConfig) -> None:
        self.config = config

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        m.submodules.oscillator = clock = io.Buffer("i", platform.request("clk100", 0, dir="-"))
        m.domains.sync = sync = ClockDomain(reset_less=True)
        m.domains.ok = host = ClockDomain(reset_less=True)
        m.d.comb += ClockSignal().eq(clock.i)
        platform.add_clock_constraint(sync.clk, SYNC_HZ)
        platform.add_clock_constraint(host.clk, OK_HZ)
        pins = OpalKellyPins(
            *(platform.request(name, 0, dir="-") for name in ("ok_uh", "ok_hu", "ok_uhu", "ok_aa"))
        )
        m.submodules.link = link = OpalKellyLink(pins)
        camera = add_camera(m, self.config, platform)
        if self.config.sensor:
            add_sensor(m, camera, platform, PortableLaneInputs())
        connect(m, camera.packets, link.packets)
        connect(m, link.requests, camera.requests)
        connect(m, camera.responses, link.responses)
        return m


def _platform(pins: PinFile) -> Platform:
    platform = Xem6310Platform()
    outputs = ("trigger", "frame_sync", "sensor_expose", "sensor_read")
    platform.add_resources(
        pins.resource(name, "o" if name in outputs else "i") for name in pins.pins
    )
    return platform


def camera(options: Options) -> Target:
    """Return the camera on this board."""
    config = camera_config(options)
    check_lanes("xem6310", config, SENSOR_LANES)
    refuse_reference("xem6310", config.reference_hz, "pins named reference and time_sync")
    pins = read_pins(options.pins, "xem6310", wired(config))
    sensor_mhz = {"sensor": SENSOR_HZ / 1e6} if config.sensor else {}
    return Target(
        design="camera",
        board="xem6310",
        platform=lambda: _platform(pins),
        top=lambda: OpalKellyCamera(config),
        clocks_mhz={"sync": SYNC_HZ / 1e6, "ok": OK_HZ / 1e6, **sensor_mhz},
        lanes=config.form.lanes,
        settings=camera_settings(config),
        registers=config.registers(),
        family="xc6s",
        options={"add_constraints": IO_TIMING} if config.sensor else {},
        blackboxes=BLACKBOXES,
    )
