# SPDX-License-Identifier: Apache-2.0
"""Four ticks per clock with the I/O registers and the edge clock of the ECP5.

# Ref: Lattice FPGA-TN-02035, ECP5 and ECP5-5G High-Speed I/O Interface: GDDRX2.
"""

from __future__ import annotations

from amaranth.hdl import ClockSignal, Const, Instance, Module, Signal, Value
from amaranth.lib import io


class Ecp5Gearing:
    """ODDRX2F and IDDRX2F, between the domains `edge` (twice `pulse`) and `pulse`.

    The I/O registers are reset while the edge clock is stopped, so that all of them start their
    division on the same edge, also after the PLL has lost its lock (see `boards.ecp5_clocks`).
    The reset never changes while clocks run, so its long wires have no timing to meet. ALIGNWD
    stays unconnected: there is no word to align to. Only pins on the left and right of the device
    have these registers.

    Parameters
    ----------
    reset : Value, optional
        Reset of the I/O registers; by default they have none.

    The latencies count register stages: IDDRX2F gathers two edge-clock cycles, moves them to a
    register of the system clock and that to its output; ODDRX2F takes a word into a register of
    the system clock, then one of the edge clock, then shifts.
    """

    lanes = 4
    input_latency = 3
    output_latency = 2

    def __init__(self, reset: Value | None = None) -> None:
        self.reset = Const(0) if reset is None else reset

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Add a sampler and return its word."""
        m.submodules[f"{name}_buffer"] = buffer = io.Buffer("i", port)
        word = Signal(4, name=f"{name}_word")
        m.submodules[f"{name}_iddr"] = Instance(
            "IDDRX2F",
            i_D=buffer.i,
            i_ECLK=ClockSignal("edge"),
            i_SCLK=ClockSignal("pulse"),
            i_RST=self.reset,
            **{f"o_Q{lane}": word[lane] for lane in range(4)},
        )
        return word

    def add_output(
        self, m: Module, name: str, port: object, word: Value, /, *, enable: Value | None = None
    ) -> None:
        """Add a serialiser; `enable` acts on the pin without a clock."""
        m.submodules[f"{name}_buffer"] = buffer = io.Buffer("o", port)
        if enable is not None:
            m.d.comb += buffer.oe.eq(enable)
        m.submodules[f"{name}_oddr"] = Instance(
            "ODDRX2F",
            o_Q=buffer.o,
            i_ECLK=ClockSignal("edge"),
            i_SCLK=ClockSignal("pulse"),
            i_RST=self.reset,
            **{f"i_D{lane}": word[lane] for lane in range(4)},
        )
