# SPDX-License-Identifier: Apache-2.0
"""Gearing with Amaranth's portable I/O buffers: double or single data rate on any family."""

from __future__ import annotations

from amaranth.hdl import ClockDomain, ClockSignal, Module, Signal, Value
from amaranth.lib import io


class DoubleDataRateGearing:
    """Two ticks per clock, through `amaranth.lib.io.DDRBuffer`.

    Parameters
    ----------
    output_latency : int
        Latency of the family's output register in clocks.
    own_sampler : bool
        Sample with two fabric registers on opposite clock edges. Spartan-3 needs this because
        Amaranth 0.5 drives its input buffer twice.
    """

    lanes = 2

    def __init__(self, *, output_latency: int = 1, own_sampler: bool = False) -> None:
        self.input_latency = 2
        self.output_latency = output_latency
        self._own_sampler = own_sampler

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Add a sampler and return its word."""
        word = Signal(2, name=f"{name}_word")
        if self._own_sampler:
            falling = f"{name}_falling"
            m.domains += ClockDomain(falling, clk_edge="neg", local=True, reset_less=True)
            m.d.comb += ClockSignal(falling).eq(ClockSignal("pulse"))
            m.submodules[f"{name}_buffer"] = buffer = io.Buffer("i", port)
            early = Signal(name=f"{name}_early")
            late = Signal(name=f"{name}_late")
            m.d.pulse += [early.eq(buffer.i), word.eq(early | late << 1)]
            m.d[falling] += late.eq(buffer.i)
        else:
            m.submodules[f"{name}_ddr"] = buffer = io.DDRBuffer("i", port, i_domain="pulse")
            m.d.pulse += word.eq(buffer.i[0] | buffer.i[1] << 1)
        return word

    def add_output(
        self, m: Module, name: str, port: object, word: Value, /, *, enable: Value | None = None
    ) -> None:
        """Add a serialiser; `enable` takes effect with a clock."""
        m.submodules[f"{name}_ddr"] = buffer = io.DDRBuffer("o", port, o_domain="pulse")
        if enable is not None:
            m.d.comb += buffer.oe.eq(enable)
        m.d.comb += [buffer.o[0].eq(word[0]), buffer.o[1].eq(word[1])]


class SingleDataRateGearing:
    """One tick per clock, through `amaranth.lib.io.FFBuffer`."""

    lanes = 1
    input_latency = 1
    output_latency = 1

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Add a sampler and return its word."""
        m.submodules[f"{name}_ff"] = buffer = io.FFBuffer("i", port, i_domain="pulse")
        return Value.cast(buffer.i)

    def add_output(
        self, m: Module, name: str, port: object, word: Value, /, *, enable: Value | None = None
    ) -> None:
        """Add a register; `enable` takes effect with a clock."""
        m.submodules[f"{name}_ff"] = buffer = io.FFBuffer("o", port, o_domain="pulse")
        if enable is not None:
            m.d.comb += buffer.oe.eq(enable)
        m.d.comb += buffer.o.eq(word)
