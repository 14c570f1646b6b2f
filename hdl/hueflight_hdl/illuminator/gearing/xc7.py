# SPDX-License-Identifier: Apache-2.0
"""Four ticks per clock with the I/O serialisers of Xilinx 7-series.

# Ref: Xilinx UG471, 7 Series FPGAs SelectIO Resources, chapter 3: ISERDESE2 and OSERDESE2.
"""

from __future__ import annotations

from amaranth.hdl import ClockSignal, Const, Instance, Module, Signal, Value
from amaranth.lib import io


class Xc7Gearing:
    """OSERDESE2 and ISERDESE2 at double data rate, between the domains `edge` and `pulse`.

    `edge` runs at twice the frequency of `pulse`, from the same PLL. A pin is released through
    the unregistered path of the serialiser (``DATA_RATE_TQ`` is ``BUF``), which needs no clock.

    The latencies are those of the ECP5's gearing and only serve `SimulatedGearing`: those of the
    serialisers are constant, but must be taken from a measurement or the vendor's simulation.

    Parameters
    ----------
    reset : Value
        Resets the serialisers; it must fall with a clock of `pulse`.
    """

    lanes = 4
    input_latency = 3
    output_latency = 2

    def __init__(self, reset: Value) -> None:
        self.reset = reset

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Add a sampler and return its word."""
        m.submodules[f"{name}_buffer"] = buffer = io.Buffer("i", port)
        word = Signal(4, name=f"{name}_word")
        m.submodules[f"{name}_serdes"] = Instance(
            "ISERDESE2",
            p_DATA_RATE="DDR",
            p_DATA_WIDTH=4,
            p_INTERFACE_TYPE="NETWORKING",
            p_SERDES_MODE="MASTER",
            p_NUM_CE=1,
            p_IOBDELAY="NONE",
            i_D=buffer.i,
            i_DDLY=Const(0),
            i_CE1=Const(1),
            i_CE2=Const(1),
            i_CLK=ClockSignal("edge"),
            i_CLKB=~ClockSignal("edge"),
            i_CLKDIV=ClockSignal("pulse"),
            i_CLKDIVP=Const(0),
            i_OCLK=Const(0),
            i_OCLKB=Const(1),
            i_RST=self.reset,
            i_BITSLIP=Const(0),
            i_SHIFTIN1=Const(0),
            i_SHIFTIN2=Const(0),
            i_OFB=Const(0),
            i_DYNCLKSEL=Const(0),
            i_DYNCLKDIVSEL=Const(0),
            # the earliest sample is at the highest output
            **{f"o_Q{4 - lane}": word[lane] for lane in range(4)},
        )
        return word

    def add_output(
        self, m: Module, name: str, port: object, word: Value, /, *, enable: Value | None = None
    ) -> None:
        """Add a serialiser; `enable` acts on the pin without a clock."""
        m.submodules[f"{name}_buffer"] = buffer = io.Buffer("o", port)
        release = Signal(name=f"{name}_release")
        m.d.comb += buffer.oe.eq(~release)
        m.submodules[f"{name}_serdes"] = Instance(
            "OSERDESE2",
            p_DATA_RATE_OQ="DDR",
            p_DATA_RATE_TQ="BUF",
            p_DATA_WIDTH=4,
            p_TRISTATE_WIDTH=1,
            p_SERDES_MODE="MASTER",
            p_INIT_OQ=Const(0, 1),
            p_SRVAL_OQ=Const(0, 1),
            p_INIT_TQ=Const(1, 1),
            p_SRVAL_TQ=Const(1, 1),
            i_CLK=ClockSignal("edge"),
            i_CLKDIV=ClockSignal("pulse"),
            i_RST=self.reset,
            i_OCE=Const(1),
            i_TCE=Const(1),
            i_T1=Const(0) if enable is None else ~enable,
            i_T2=Const(0),
            i_T3=Const(0),
            i_T4=Const(0),
            i_TBYTEIN=Const(0),
            i_SHIFTIN1=Const(0),
            i_SHIFTIN2=Const(0),
            o_OQ=buffer.o,
            o_TQ=release,
            **{f"i_D{lane + 1}": word[lane] if lane < 4 else Const(0) for lane in range(8)},
        )
