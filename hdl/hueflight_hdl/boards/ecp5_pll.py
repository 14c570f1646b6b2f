# SPDX-License-Identifier: Apache-2.0
"""The PLL of the ECP5.

# Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL.
"""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.hdl import Const, Instance, Signal, Value


@dataclass(frozen=True)
class PllOutput:
    """A clock at an input or output of a PLL."""

    clock: Value
    hz: float


def ecp5_pll(
    reference: PllOutput,
    primary: PllOutput,
    secondary: PllOutput | None = None,
    /,
    *,
    vco_hz: float,
    locked: Signal,
) -> Instance:
    """Return a PLL whose first output is its feedback.

    Parameters
    ----------
    reference, primary, secondary : PllOutput
        What it runs from, and what it makes; the primary's frequency is a multiple of the
        reference's.
    vco_hz : float
        Of the oscillator, from 400 to 800 MHz; a multiple of what is made.
    locked : Signal
        The outputs are as they should be.
    """
    more = {}
    if secondary is not None:
        more = {
            "a_FREQUENCY_PIN_CLKOS": f"{secondary.hz / 1e6:g}",
            "p_CLKOS_ENABLE": "ENABLED",
            "p_CLKOS_DIV": round(vco_hz / secondary.hz),
            "p_CLKOS_CPHASE": 0,
            "p_CLKOS_FPHASE": 0,
            "o_CLKOS": secondary.clock,
        }
    return Instance(
        "EHXPLLL",
        a_FREQUENCY_PIN_CLKI=f"{reference.hz / 1e6:g}",
        a_FREQUENCY_PIN_CLKOP=f"{primary.hz / 1e6:g}",
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
        p_CLKFB_DIV=round(primary.hz / reference.hz),
        p_FEEDBK_PATH="CLKOP",
        p_CLKOP_ENABLE="ENABLED",
        p_CLKOP_DIV=round(vco_hz / primary.hz),
        p_CLKOP_CPHASE=0,
        p_CLKOP_FPHASE=0,
        i_RST=Const(0),
        i_STDBY=Const(0),
        i_CLKI=reference.clock,
        i_CLKFB=primary.clock,
        i_PHASESEL0=Const(0),
        i_PHASESEL1=Const(0),
        i_PHASEDIR=Const(1),
        i_PHASESTEP=Const(1),
        i_PHASELOADREG=Const(1),
        i_PLLWAKESYNC=Const(0),
        i_ENCLKOP=Const(0),
        o_CLKOP=primary.clock,
        o_LOCK=locked,
        **more,
    )
