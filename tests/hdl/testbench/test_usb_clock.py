# SPDX-License-Identifier: Apache-2.0
"""The ECPIX-5's USB transceiver is reset first, and the logic on its clock starts after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from amaranth.build import Attrs, Pins, Resource
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Module, Signal
from amaranth_boards.ecpix5 import ECPIX585Platform

from hueflight_hdl.boards import ecpix5
from hueflight_hdl.boards.pins import drive_pin, input_of
from hueflight_hdl.boards.target import Target
from hueflight_hdl.build.project import write_project
from hueflight_hdl.testbench.pin_events import PinBench

PHY_CLOCKS = 40  # instead of a millisecond
OSCILLATOR_PS, USB_PS = 10_000, 16_666
END_PS = 4 * PHY_CLOCKS * OSCILLATOR_PS
_ATTRS = Attrs(IO_TYPE="LVCMOS33")

pytestmark = pytest.mark.slow


class UsbClockTop(Elaboratable):
    """The clock of USB, with the transceiver's reset and a register of the domain on pins."""

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = ClockDomain(reset_less=True)
        oscillator = input_of(m, "oscillator", platform.request("clk100", 0, dir="-"))
        m.d.comb += ClockSignal("sync").eq(oscillator)
        reset, level = Signal(init=1), Signal()
        clock = input_of(m, "usb_in", platform.request("usb_in", 0, dir="-"))
        ecpix5._UsbClock(clock, reset).add_to(m, platform)
        m.d.usb += level.eq(~level)
        drive_pin(m, platform, "phy_reset", reset)
        drive_pin(m, platform, "level", level)
        return m


def platform():
    made = ECPIX585Platform()
    pins = {"usb_in": ("V23", "i"), "phy_reset": ("E26", "o"), "level": ("D25", "o")}
    made.add_resources(
        [Resource(name, 0, Pins(pin, dir=way), _ATTRS) for name, (pin, way) in pins.items()]
    )
    return made


def test_the_transceiver_is_reset_and_then_the_logic_on_its_clock_runs(
    verilator: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(ecpix5, "_PHY_CLOCKS", PHY_CLOCKS)
    write_project(
        Target("camera", "ecpix5-85f", platform, UsbClockTop, {}, "ecp5"),
        tmp_path,
        constraints=False,
    )
    bench = PinBench(
        (tmp_path / "top.v").read_text(),
        {"clk100_0__io": 1, "usb_in_0__io": 1},
        {"phy_reset_0__io": 1, "level_0__io": 1},
    )
    changes = [(time, 1) for time in range(OSCILLATOR_PS // 2, END_PS, OSCILLATOR_PS // 2)]
    changes += [(time, 2) for time in range(USB_PS // 2, END_PS, USB_PS // 2)]
    word, events = 0, []
    for time, bit in sorted(changes):
        word ^= bit
        events.append((time, word))
    seen = bench.run(events)
    bench.close()

    resets = np.array([word & 1 for _, word in seen])
    assert resets[0] == 1
    (released,) = np.flatnonzero(np.diff(resets) == -1)
    assert seen[released + 1][0] == pytest.approx(PHY_CLOCKS * OSCILLATOR_PS, abs=2 * OSCILLATOR_PS)
    assert not resets[released + 1 :].any()
    toggles = [time for (time, word), (_, last) in zip(seen[1:], seen, strict=False)
               if (word ^ last) & 2]  # fmt: skip
    begin = 2 * PHY_CLOCKS * OSCILLATOR_PS
    assert begin <= toggles[0] <= begin + 4 * USB_PS
    assert (np.diff(toggles) == 2 * (USB_PS // 2)).all()
    assert END_PS - toggles[-1] <= 2 * USB_PS
