"""Clocks of ECP5 boards: an edge clock, half of it for the pulses, and one for control.

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

EDGE_HZ = 400e6
PULSE_HZ = EDGE_HZ / 2
SYNC_HZ = 50e6
AIM = 1.15
"""Place and route aims so much higher than needed; it stops trying where it is content."""
_VCO_HZ = 800e6


class Ecp5Clocks(Elaboratable):
    """Domains `edge` (400 MHz), `pulse` (200 MHz) and `sync` (50 MHz).

    No domain has a reset. All clocks stand still until the PLL has locked, so that every
    register leaves its configured value on the same, clean edge.

    Parameters
    ----------
    clock : Signal
        From the oscillator.
    clock_hz : float
        25 or 100 MHz.
    """

    def __init__(self, clock: Value, clock_hz: float) -> None:
        self.clock = clock
        self.clock_hz = clock_hz

    def add_to(self, m: Module, platform: Platform) -> None:
        """Add the domains to a module, and with them what makes them."""
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
        m.submodules.pll = Instance(
            "EHXPLLL",
            a_FREQUENCY_PIN_CLKI=f"{self.clock_hz / 1e6:g}",
            a_FREQUENCY_PIN_CLKOP=f"{EDGE_HZ / 1e6:g}",
            a_FREQUENCY_PIN_CLKOS=f"{SYNC_HZ / 1e6:g}",
            a_ICP_CURRENT="12",
            a_LPF_RESISTOR="8",
            p_PLLRST_ENA="DISABLED",
            p_INTFB_WAKE="DISABLED",
            p_STDBY_ENABLE="DISABLED",
            p_DPHASE_SOURCE="DISABLED",
            p_OUTDIVIDER_MUXA="DIVA",
            p_OUTDIVIDER_MUXB="DIVB",
            p_OUTDIVIDER_MUXC="DIVC",
            p_OUTDIVIDER_MUXD="DIVD",
            p_CLKI_DIV=1,
            p_CLKFB_DIV=round(EDGE_HZ / self.clock_hz),
            p_FEEDBK_PATH="CLKOP",
            p_CLKOP_ENABLE="ENABLED",
            p_CLKOP_DIV=round(_VCO_HZ / EDGE_HZ),
            p_CLKOP_CPHASE=0,
            p_CLKOP_FPHASE=0,
            p_CLKOS_ENABLE="ENABLED",
            p_CLKOS_DIV=round(_VCO_HZ / SYNC_HZ),
            p_CLKOS_CPHASE=0,
            p_CLKOS_FPHASE=0,
            i_RST=Const(0),
            i_STDBY=Const(0),
            i_CLKI=self.clock,
            i_CLKFB=fast,
            i_PHASESEL0=Const(0),
            i_PHASESEL1=Const(0),
            i_PHASEDIR=Const(1),
            i_PHASESTEP=Const(1),
            i_PHASELOADREG=Const(1),
            i_PLLWAKESYNC=Const(0),
            i_ENCLKOP=Const(0),
            o_CLKOP=fast,
            o_CLKOS=slow,
            o_LOCK=locked,
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
        m.submodules.sync = Instance("DCCA", i_CLKI=slow, i_CE=locked, o_CLKO=ClockSignal("sync"))
        return m
