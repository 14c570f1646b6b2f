# SPDX-License-Identifier: Apache-2.0
"""Clocks of the illuminator on ECP5: edge clock, pulse clock and control clock.

# Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL; FPGA-TN-02035, GDDRX2 and the
# synchronization of its start (GDDR_SYNC).
"""

from __future__ import annotations

from amaranth.build import Platform
from amaranth.hdl import (
    ClockDomain,
    ClockSignal,
    Const,
    Elaboratable,
    Instance,
    Module,
    Signal,
    Value,
)
from amaranth.lib.cdc import AsyncFFSynchronizer

from .ecp5_pll import PllOutput, ecp5_pll
from .ecp5_reference import Ecp5Reference
from .target import TargetError

PULSE_HZ = 200e6
CLOCK_RATIO = 4
"""Clocks of `pulse` in one of `sync`."""
AIM = 1.15
"""Place and route aims so much higher than needed; it stops trying where it is content."""
MIN_PULSE_HZ, MAX_PULSE_HZ = 100e6, 200e6
"""The PLL's oscillator runs at four times `pulse`, and may from 400 to 800 MHz."""
RECOVERY_CLOCKS = 16
"""Clocks of `sync` after a failure: more than disarming takes to reach the pins."""
_START_CLOCKS = 8
"""Clocks of the oscillator between the steps of the start."""


def check_clocks(clock_hz: float, pulse_hz: float, /) -> None:
    """Check that the PLL can make the clocks of the illuminator.

    Raises
    ------
    TargetError
        If it cannot; the message says which frequencies there are.
    """
    if not MIN_PULSE_HZ <= pulse_hz <= MAX_PULSE_HZ:
        raise TargetError(
            f"pulse_hz = {pulse_hz:g}: must be from {MIN_PULSE_HZ:g} to {MAX_PULSE_HZ:g}"
        )
    multiple = 2 * pulse_hz / clock_hz
    if abs(multiple - round(multiple)) > 1e-9 or round(multiple) < 1:
        steps = range(int(2 * MIN_PULSE_HZ / clock_hz), int(2 * MAX_PULSE_HZ / clock_hz) + 1)
        choices = [step * clock_hz / 2e6 for step in steps]
        shown = ", ".join(f"{mhz:g}" for mhz in choices if mhz >= MIN_PULSE_HZ / 1e6)
        raise TargetError(
            f"pulse_hz = {pulse_hz:g}: half a multiple of the clock of {clock_hz:g} Hz is needed: "
            f"{shown} MHz"
        )


class IoStart(Elaboratable):
    """Starts divider and I/O registers in the order that the vendor asks for.

    While the PLL has not locked, the edge clock is stopped and they are held in reset, at once
    and without a clock. After the lock the reset is released first and the edge clock later, so
    that divider and I/O registers all begin with the same edge.

    Parameters
    ----------
    clock : Value
        From the oscillator.
    locked : Value
        The clocks are as they should be; asynchronous.

    Attributes
    ----------
    stop : Signal
        The edge clock is stopped.
    reset : Signal
        Divider and I/O registers are in reset.
    """

    def __init__(self, clock: Value, locked: Value) -> None:
        self.clock = clock
        self.locked = locked
        self.stop = Signal(init=1)
        self.reset = Signal(init=1)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        start = ClockDomain("start", async_reset=True, local=True)
        m.domains += start
        m.d.comb += start.clk.eq(self.clock)
        m.submodules.lost = AsyncFFSynchronizer(~self.locked, start.rst, o_domain="start")
        count = Signal(range(2 * _START_CLOCKS + 1))
        with m.If(count != 2 * _START_CLOCKS):
            m.d.start += count.eq(count + 1)
        m.d.start += [
            self.reset.eq(count < _START_CLOCKS),
            self.stop.eq(count < 2 * _START_CLOCKS),
        ]
        return m


class Ecp5Clocks(Elaboratable):
    """Domains `edge` (twice `pulse`), `pulse` and `sync` (a quarter of `pulse`).

    No domain has a reset. All clocks are stopped until the PLL has locked and the I/O registers
    have been reset, so that every register leaves its configured value on the same clean edge.

    Parameters
    ----------
    clock : Signal
        From the oscillator.
    clock_hz : float
        Frequency of the oscillator; twice `pulse_hz` must be a multiple of it.
    pulse_hz : float
        Frequency of the domain `pulse`.
    reference : Ecp5Reference, optional
        An external clock that the host may choose instead of the oscillator.

    Attributes
    ----------
    failed : Signal
        High while the PLL has not locked and for `RECOVERY_CLOCKS` after. It rises without a
        clock, from a preset of flip-flops, because all clocks stop with the lock.
    io_reset : Signal
        Resets the I/O registers; it is released while the edge clock is stopped.
    """

    def __init__(
        self,
        clock: Value,
        clock_hz: float,
        *,
        pulse_hz: float = PULSE_HZ,
        reference: Ecp5Reference | None = None,
    ) -> None:
        self.clock = clock
        self.clock_hz = clock_hz
        self.pulse_hz = pulse_hz
        self.reference = reference
        self.failed = Signal(init=1)
        self.io_reset = Signal(init=1)

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        for name, frequency in (
            ("edge", 2 * self.pulse_hz),
            ("pulse", self.pulse_hz),
            ("sync", self.pulse_hz / CLOCK_RATIO),
        ):
            domain = ClockDomain(name, reset_less=True)
            m.domains += domain
            if name != "edge":  # nothing of the fabric runs on it
                platform.add_clock_constraint(domain.clk, frequency * AIM)
        m.submodules.clocks = self

    def elaborate(self, platform: Platform) -> Module:
        m = Module()
        fast = Signal()
        slow = Signal()
        locked = Signal()
        source, good, reset = self.clock, locked, None
        if self.reference is not None:
            m.submodules.reference = self.reference
            source, reset = self.reference.chosen, self.reference.hold
            good = locked & ~self.reference.hold
            m.d.comb += self.reference.locked.eq(locked)
        m.submodules.pll = ecp5_pll(
            PllOutput(source, self.clock_hz),
            PllOutput(fast, 2 * self.pulse_hz),
            PllOutput(slow, self.pulse_hz / CLOCK_RATIO),
            vco_hz=4 * self.pulse_hz,
            locked=locked,
            reset=reset,
            place=None if self.reference is None else self.reference.place,
        )
        m.submodules.start = start = IoStart(self.clock, good)
        m.d.comb += self.io_reset.eq(start.reset)
        m.submodules.edge = Instance(
            "ECLKSYNCB", i_ECLKI=fast, i_STOP=start.stop, o_ECLKO=ClockSignal("edge")
        )
        m.submodules.pulse = Instance(
            "CLKDIVF",
            p_DIV="2.0",
            i_CLKI=ClockSignal("edge"),
            i_RST=start.reset,
            i_ALIGNWD=Const(0),
            o_CDIVX=ClockSignal("pulse"),
        )
        m.submodules.failed = AsyncFFSynchronizer(
            ~good, self.failed, o_domain="sync", stages=RECOVERY_CLOCKS
        )
        m.submodules.sync = Instance(
            "DCCA", i_CLKI=slow, i_CE=~start.stop, o_CLKO=ClockSignal("sync")
        )
        return m
