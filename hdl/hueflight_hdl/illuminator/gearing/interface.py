# SPDX-License-Identifier: Apache-2.0
"""The interface of a gearing: words of lanes inside the FPGA, a faster signal at the pin."""

from __future__ import annotations

from typing import Protocol

from amaranth.hdl import Module, Value


class Gearing(Protocol):
    """Serialises outputs and samples inputs.

    A `port` is the object that the Amaranth platform returns for a pin.

    Attributes
    ----------
    lanes : int
        Ticks per clock of the domain `pulse`; lane 0 is the earliest.
    input_latency, output_latency : int
        Clocks from a pin to the word, and from the word to the pin.
    """

    lanes: int
    input_latency: int
    output_latency: int

    def add_input(self, m: Module, name: str, port: object, /) -> Value:
        """Add a sampler to `m` and return its word."""
        ...

    def add_output(
        self, m: Module, name: str, port: object, word: Value, /, *, enable: Value | None = None
    ) -> None:
        """Add a serialiser of `word` to `m`.

        The pin is driven only while `enable` is high. Whether it is released without a clock
        depends on the family; see the class.
        """
        ...
