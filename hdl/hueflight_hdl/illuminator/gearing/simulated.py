# SPDX-License-Identifier: Apache-2.0
"""A simulation model of any gearing: a word of ticks per clock for each pin."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value

from .interface import Gearing


class SimulatedGearing:
    """Delays words by the latency of another gearing.

    Parameters
    ----------
    original : Gearing
        Gearing whose lanes and latencies are modelled. A port is a word of `lanes` bits.
    """

    def __init__(self, original: Gearing) -> None:
        self.lanes = original.lanes
        self.input_latency = original.input_latency
        self.output_latency = original.output_latency

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Return the port's word, later."""
        return self._later(m, name, Value.cast(port), self.input_latency)

    def add_output(
        self, m: Module, name: str, port: object, word: Value, /, *, enable: Value | None = None
    ) -> None:
        """Drive the port with the delayed word; it is 0 at once while `enable` is low."""
        later = self._later(m, name, word, self.output_latency)
        m.d.comb += Value.cast(port).eq(later if enable is None else Mux(enable, later, 0))

    def _later(self, m: Module, name: str, word: Value, clocks: int) -> Value:
        for clock in range(clocks):
            later = Signal(self.lanes, name=f"{name}_{clock}")
            m.d.pulse += later.eq(word)
            word = later
        return word
