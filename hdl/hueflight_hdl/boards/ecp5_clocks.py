"""Clocks of the illuminator on ECP5: edge clock, pulse clock and control clock.

# Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL; FPGA-TN-02035, GDDRX2.
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

EDGE_HZ = 400e6
PULSE_HZ = EDGE_HZ / 2
SYNC_HZ = 50e6
AIM = 1.15
"""Place and route aims so much higher than needed; it stops trying where it is content."""
_VCO_HZ = 800e6
RECOVERY_CLOCKS = 16
"""Clocks of `sync` after a failure: more than disarming takes to reach the pins."""


class Ecp5Clocks(Elaboratable):
    """Domains `edge` (400 MHz), `pulse` (200 MHz) and `sync` (50 MHz).

    No domain has a reset. All clocks are stopped until the PLL has locked, so that every
    register leaves its configured value on the same clean edge.

    Parameters
    ----------
    clock : Signal
        From the oscillator.
    clock_hz : float
        25 or 100 MHz.

    Attributes
    ----------
    failed : Signal
        High while the PLL has not locked and for `RECOVERY_CLOCKS` after. It rises without a
        clock, from a preset of flip-flops, because all clocks stop with the lock.
    """

    def __init__(self, clock: Value, clock_hz: float) -> None:
        self.clock = clock
        self.clock_hz = clock_hz
        self.failed = Signal(init=1)

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the clock domains to a module, and the logic that generates them."""
        for name, frequency in (("edge", EDGE_HZ), ("pulse", PULSE_HZ), ("sync", SYNC_HZ)):
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
        m.submodules.pll = ecp5_pll(
            PllOutput(self.clock, self.clock_hz),
            PllOutput(fast, EDGE_HZ),
            PllOutput(slow, SYNC_HZ),
            vco_hz=_VCO_HZ,
            locked=locked,
        )
        m.submodules.edge = Instance(
            "ECLKSYNCB", i_ECLKI=fast, i_STOP=~locked, o_ECLKO=ClockSignal("edge")
        )
        m.submodules.pulse = Instance(
            "CLKDIVF",
            p_DIV="2.0",
            i_CLKI=ClockSignal("edge"),
            i_RST=~locked,
            i_ALIGNWD=Const(0),
            o_CDIVX=ClockSignal("pulse"),
        )
        m.submodules.failed = AsyncFFSynchronizer(
            ~locked, self.failed, o_domain="sync", stages=RECOVERY_CLOCKS
        )
        m.submodules.sync = Instance("DCCA", i_CLKI=slow, i_CE=locked, o_CLKO=ClockSignal("sync"))
        return m
