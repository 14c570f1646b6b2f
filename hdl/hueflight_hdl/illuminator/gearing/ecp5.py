# SPDX-License-Identifier: Apache-2.0
"""Four ticks per clock with the I/O registers and the edge clock of the ECP5.

# Ref: Lattice FPGA-TN-02035, ECP5 and ECP5-5G High-Speed I/O Interface: GDDRX2, DELAYF.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from amaranth.hdl import ClockSignal, Const, Instance, Module, Signal, Value
from amaranth.lib import io


@dataclass(frozen=True)
class DelayLine:
    """Control of the fine delay line behind an output.

    Attributes
    ----------
    load : Value
        While high, the line is at its setting from configuration, 0.
    move : Value
        A pulse makes the delay longer by a step.
    """

    load: Value
    move: Value


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
    delays : mapping of str to DelayLine, optional
        Fine delay lines, DELAYF, by the name of the output. The other outputs then have one that
        stays at 0, DELAYG, so that all take the same way.

    The latencies count register stages: IDDRX2F gathers two edge-clock cycles, moves them to a
    register of the system clock and that to its output; ODDRX2F takes a word into a register of
    the system clock, then one of the edge clock, then shifts. One more register of the system clock
    in front of it halves the wires from a channel to the edge of the device, which decided whether
    a ULX3S reached its frequency.
    """

    lanes = 4
    input_latency = 3
    output_latency = 3

    def __init__(
        self, reset: Value | None = None, *, delays: Mapping[str, DelayLine] | None = None
    ) -> None:
        self.reset = Const(0) if reset is None else reset
        self.delays = delays or {}

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
        near = Signal(4, name=f"{name}_near")
        m.d.pulse += near.eq(word)
        early = buffer.o
        if self.delays:
            early = Signal(name=f"{name}_early")
            m.submodules[f"{name}_delay"] = self._delay(self.delays.get(name), early, buffer.o)
        m.submodules[f"{name}_oddr"] = Instance(
            "ODDRX2F",
            o_Q=early,
            i_ECLK=ClockSignal("edge"),
            i_SCLK=ClockSignal("pulse"),
            i_RST=self.reset,
            **{f"i_D{lane}": near[lane] for lane in range(4)},
        )

    @staticmethod
    def _delay(line: DelayLine | None, early: Value, late: Value) -> Instance:
        # DEL_VALUE as a number: nextpnr takes the names of the vendor's manual, DELAY0 to
        # DELAY127, for the default of the mode
        setting = {"p_DEL_MODE": "USER_DEFINED", "p_DEL_VALUE": 0, "i_A": early, "o_Z": late}
        if line is None:
            return Instance("DELAYG", **setting)
        return Instance(
            "DELAYF", **setting, i_LOADN=~line.load, i_MOVE=line.move, i_DIRECTION=Const(0)
        )
