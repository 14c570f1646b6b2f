# SPDX-License-Identifier: Apache-2.0
"""The PLL of the ECP5.

# Ref: Lattice FPGA-TN-02200, ECP5 and ECP5-5G sysCLOCK PLL/DLL.
"""

from __future__ import annotations

from dataclasses import dataclass

from amaranth.hdl import Const, Instance, Signal, Value

EDGES = ("left", "right")
_PLACES = {
    "12": ("X2/Y49/EHXPLL_LL", "X70/Y49/EHXPLL_LR"),
    "25": ("X2/Y49/EHXPLL_LL", "X70/Y49/EHXPLL_LR"),
    "45": ("X2/Y70/EHXPLL_LL", "X88/Y70/EHXPLL_LR"),
    "85": ("X2/Y94/EHXPLL_LL", "X124/Y94/EHXPLL_LR"),
}
"""Names that nextpnr gives to the lower PLLs of each size, left and right."""


def pll_place(device: str, edge: str, /) -> str:
    """Return where a PLL must be to reach the edge clock of the left or right edge.

    Parameters
    ----------
    device : str
        Part, for example ``LFE5U-25F``.
    edge : {"left", "right"}
        Edge of the device with the geared pins.

    Returns
    -------
    str
        Name of the place.
    """
    return _PLACES[device.partition("-")[2][:2]][EDGES.index(edge)]


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
    reset: Value | None = None,
    place: str | None = None,
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
    reset : Value, optional
        Stops the oscillator and clears the outputs' dividers; without a clock.
    place : str, optional
        See `pll_place`; by default the router takes the PLL next to the reference's pin.
    """
    more = {} if place is None else {"a_BEL": place}
    if secondary is not None:
        more |= {
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
        p_PLLRST_ENA="DISABLED" if reset is None else "ENABLED",
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
        i_RST=Const(0) if reset is None else reset,
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
