"""Four ticks per clock with the I/O registers and the edge clock of the ECP5.

# Ref: Lattice FPGA-TN-02035, ECP5 and ECP5-5G High-Speed I/O Interface: GDDRX2.
"""

from __future__ import annotations

from amaranth.hdl import ClockSignal, Const, Instance, Module, Signal, Value
from amaranth.lib import io


class Ecp5Gearing:
    """ODDRX2F and IDDRX2F, between the domains `edge` (twice `pulse`) and `pulse`.

    The resets of the I/O registers are tied off: a reset from the fabric would be the slowest
    path of all, and the edge clock is stopped until the PLL has locked, so that every register
    starts its division on the same edge (see `boards.ecp5_clocks`). ALIGNWD stays unconnected:
    there is no word to align to. Only pins on the left and right of the device have these
    registers.

    The latencies count register stages: IDDRX2F gathers two edge-clock cycles, moves them to a
    register of the system clock and that to its output; ODDRX2F takes a word into a register of
    the system clock, then one of the edge clock, then shifts.
    """

    lanes = 4
    input_latency = 3
    output_latency = 2

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Add a sampler and return its word."""
        m.submodules[f"{name}_buffer"] = buffer = io.Buffer("i", port)
        word = Signal(4, name=f"{name}_word")
        m.submodules[f"{name}_iddr"] = Instance(
            "IDDRX2F",
            i_D=buffer.i,
            i_ECLK=ClockSignal("edge"),
            i_SCLK=ClockSignal("pulse"),
            i_RST=Const(0),
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
            i_RST=Const(0),
            **{f"i_D{lane}": word[lane] for lane in range(4)},
        )
