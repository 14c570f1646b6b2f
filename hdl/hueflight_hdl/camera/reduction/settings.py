# SPDX-License-Identifier: Apache-2.0
"""What a reduction was told, held from the beginning of a capture to its end."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from hueflight_protocol.reduction_registers import ReductionMode, ReductionRoom

WIDTH_BITS = 6
"""Of the width of a sum."""


def settings_layout(room: ReductionRoom, /) -> data.StructLayout:
    """Return the layout of what the registers ask for.

    Parameters
    ----------
    room : ReductionRoom
        What the build has room for.

    Returns
    -------
    StructLayout
        One field for each register, but those that store.
    """
    return data.StructLayout(
        {
            "mode": 2,
            "sums": 8,
            "frames": 32,
            "first": 16,
            "last": 16,
            "tables": 32,
            "moved": 32,
            "widths": data.ArrayLayout(WIDTH_BITS, room.sums),
        }
    )


class ReductionSettings(wiring.Component):
    """Takes the settings over when a capture begins, if they can be followed.

    What can't be followed sends codes: no sums or more than there is room for, a width of 0 or
    more than there is room for, or a range of codes that is empty or goes past the last code.

    Parameters
    ----------
    room : ReductionRoom
        What the build has room for.
    code_bits : int
        Width of a code.

    Members
    -------
    began : In(1)
        A capture begins.
    asked : In
        What the registers say; see `settings_layout`.
    held : Out
        What they said when the capture began.
    codes, sums : Out(1)
        What is sent in this capture.
    limits : Out
        Greatest value of each sum.
    """

    def __init__(self, room: ReductionRoom, code_bits: int) -> None:
        self.room, self.code_bits = room, code_bits
        layout = settings_layout(room)
        super().__init__(
            {
                "began": In(1),
                "asked": In(layout),
                "held": Out(layout),
                "codes": Out(1, init=1),
                "sums": Out(1),
                "limits": Out(data.ArrayLayout(room.sum_bits, room.sums)),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        asked, room = self.asked, self.room
        used = [asked.sums > k for k in range(room.sums)]
        fit = Cat(
            Mux(used[k], (asked.widths[k] != 0) & (asked.widths[k] <= room.widths[k]), 1)
            for k in range(room.sums)
        )
        said, fits = Signal.like(asked), Signal()  # a clock after the registers
        m.d.sync += said.eq(asked)
        m.d.sync += fits.eq(
            fit.all()
            & (asked.sums != 0)
            & (asked.sums <= room.sums)
            & (asked.first <= asked.last)
            & (asked.last < Const(1 << self.code_bits, 17))
            & ((asked.mode == ReductionMode.SUMS) | (asked.mode == ReductionMode.BOTH))
        )
        with m.If(self.began):
            m.d.sync += [
                self.held.eq(said),
                self.sums.eq(fits),
                self.codes.eq(~fits | (said.mode == ReductionMode.BOTH)),
            ]
        for k in range(room.sums):
            m.d.sync += self.limits[k].eq(_ones(self.held.widths[k], room.sum_bits))
        return m


def _ones(count: Value, bits: int) -> Value:
    """Return so many ones in the low bits."""
    return Cat(count > bit for bit in range(bits))
