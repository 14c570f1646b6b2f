# SPDX-License-Identifier: Apache-2.0
"""iCE40-HX8K breakout board: two ticks of 4.975 ns a clock."""

from __future__ import annotations

from amaranth.build import Attrs, Pins, Platform, Resource
from amaranth_boards.ice40_hx8k_b_evn import ICE40HX8KBEVNPlatform

from .ice40 import illuminator_target
from .target import Options, Target

PULSE_HZ = 100.5e6
"""12 MHz · 67 / 8: the PLL has no 100 MHz."""

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


def _platform() -> Platform:
    platform = ICE40HX8KBEVNPlatform()
    platform.add_resources(_RESOURCES)
    return platform


def illuminator(options: Options) -> Target:
    """Return the illuminator on this board."""
    return illuminator_target("hx8k", _platform, options, armed="led", leds=9, pulse_hz=PULSE_HZ)
