"""ULX3S with the largest ECP5: the smallest ready-made board with pins for nine channels."""

from __future__ import annotations

from amaranth.build import Attrs, Pins, Platform, Resource
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from .ecp5_clocks import PULSE_HZ, SYNC_HZ
from .ecp5_illuminator import CHANNELS_APART, Ecp5Illuminator
from .target import Target

# the right edge of the device has the I/O registers for four ticks a clock
_FAST = Attrs(IO_TYPE="LVCMOS33", DRIVE="8", SLEWRATE="FAST", PULLMODE="DOWN")
_PLAIN = Attrs(IO_TYPE="LVCMOS33", PULLMODE="DOWN")
_RESOURCES = [
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
]


def _platform() -> Platform:
    platform = ULX3S_85F_Platform()
    platform.add_resources(_RESOURCES)
    return platform


def illuminator() -> Target:
    """Return the illuminator on this board."""
    return Target(
        design="illuminator",
        board="ulx3s-85f",
        platform=_platform,
        top=lambda: Ecp5Illuminator(armed=("led", 0)),
        clocks_mhz={"pulse": PULSE_HZ / 1e6, "sync": SYNC_HZ / 1e6},
        family="ecp5",
        options=CHANNELS_APART,
    )
