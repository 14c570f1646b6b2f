# SPDX-License-Identifier: Apache-2.0
"""A few sums of all pixels: the memory that holds them, and what adds to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

if TYPE_CHECKING:
    from .windows import BlockPlan

SLICE_SUMS = 2
"""Sums of a slice: two of nine bits in eight lanes just fill block RAMs of 18 bits."""
FETCH_CLOCKS = 3
"""Clocks from a request to the sums of the pixel."""


def later(m: Module, value: Value | data.View, clocks: int = 1) -> list:
    """Return a value 1, 2, … clocks later.

    Parameters
    ----------
    m : Module
        To which the registers are added.
    value : Value or View
        The value.
    clocks : int
        How many.

    Returns
    -------
    list
        As many registers.
    """
    found = []
    for _ in range(clocks):
        register = Signal(value.shape(), reset_less=True)
        m.d.sync += register.eq(value)
        found.append(value := register)
    return found


class SaturatingSum(wiring.Component):
    """Adds an entry to a sum, which stays at its greatest value; the result is a clock late.

    Parameters
    ----------
    width, entry_bits : int
        Bits of the sum and of the entry.

    Members
    -------
    before, entry : In
        The sum so far and what is added.
    limit : In
        Greatest value of the sum.
    after : Out
        Of the clock before: their sum, at most `limit`.
    """

    def __init__(self, width: int, entry_bits: int) -> None:
        self._total_bits = max(width, entry_bits) + 1
        super().__init__(
            {
                "before": In(width),
                "entry": In(entry_bits),
                "limit": In(width),
                "after": Out(width),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        total = Signal(self._total_bits)
        m.d.sync += total.eq(self.before + self.entry)
        m.d.comb += self.after.eq(Mux(total > self.limit, self.limit, total))
        return m


class SumSlice(wiring.Component):
    """Some of the sums of all pixels, and the same of the block that can be fetched.

    Parameters
    ----------
    plan : BlockPlan
        Groups and blocks of a frame.
    lanes : int
        Pixels of a group.
    widths : sequence of int
        Bits of each sum.
    entry_bits : int
        Bits of a table entry.

    Members
    -------
    group : In
        Group whose sums are read.
    fresh, store, store_fresh, at : In
        Two clocks later: its sums begin from 0; those before belong to the buffer, as 0, and where.
    entries : In
        Three clocks later: what is added, 0 for pixels without a code.
    write, write_group : In
        Five clocks later: the sums are written.
    limits : In
        Greatest value of each sum.
    fetch_at, fetch_lane : In
        Place in the block, and lane, of a pixel whose sums are wanted.
    pixel : Out
        They, `FETCH_CLOCKS` later.
    """

    def __init__(self, plan: BlockPlan, lanes: int, widths: Sequence[int], entry_bits: int) -> None:
        self.plan, self.lanes = plan, lanes
        self.widths, self.entry_bits = tuple(widths), entry_bits
        self.pixel_layout = data.ArrayLayout(max(widths), len(self.widths))
        super().__init__(
            {
                "group": In(range(plan.groups)),
                "fresh": In(1),
                "store": In(1),
                "store_fresh": In(1),
                "at": In(range(plan.block_groups)),
                "entries": In(
                    data.ArrayLayout(data.ArrayLayout(entry_bits, len(self.widths)), lanes)
                ),
                "write": In(1),
                "write_group": In(range(plan.groups)),
                "limits": In(self.pixel_layout),
                "fetch_at": In(range(plan.block_groups)),
                "fetch_lane": In(range(lanes)),
                "pixel": Out(self.pixel_layout),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        pixel = data.StructLayout({f"sum{k}": width for k, width in enumerate(self.widths)})
        layout = data.ArrayLayout(pixel, self.lanes)
        memory = Memory(shape=layout, depth=self.plan.groups, init=[])
        m.submodules.memory = memory
        write, read = memory.write_port(), memory.read_port()
        m.d.comb += read.addr.eq(self.group)

        before = later(m, read.data)[-1]
        self._buffer(m, layout, before)
        begun = later(m, Mux(self.fresh, 0, before))[-1]
        after = Signal(layout)
        for lane in range(self.lanes):
            for k, width in enumerate(self.widths):
                m.submodules[f"sum{k}_{lane}"] = adder = SaturatingSum(width, self.entry_bits)
                m.d.comb += [
                    adder.before.eq(layout(begun)[lane][f"sum{k}"]),
                    adder.entry.eq(self.entries[lane][k]),
                    adder.limit.eq(self.limits[k]),
                ]
                m.d.sync += after[lane][f"sum{k}"].eq(adder.after)
        m.d.comb += [
            write.en.eq(self.write),
            write.addr.eq(self.write_group),
            write.data.eq(after),
        ]
        return m

    def _buffer(self, m: Module, layout: data.ArrayLayout, sums: data.View) -> None:
        """Hold the sums of a block, and fetch those of a pixel."""
        memory = Memory(
            shape=layout, depth=self.plan.block_groups, init=[],
            attrs={"ram_style": "distributed"},
        )  # fmt: skip
        m.submodules.buffer = memory
        write, read = memory.write_port(), memory.read_port()
        m.d.sync += [
            write.en.eq(self.store),
            write.addr.eq(self.at),
            write.data.eq(Mux(self.store_fresh, 0, sums)),
        ]
        m.d.comb += read.addr.eq(self.fetch_at)
        lane = later(m, self.fetch_lane)[-1]
        chosen = Signal(self.pixel_layout, reset_less=True)
        for k in range(len(self.widths)):
            m.d.sync += chosen[k].eq(read.data[lane][f"sum{k}"])
        m.d.sync += self.pixel.eq(chosen)
