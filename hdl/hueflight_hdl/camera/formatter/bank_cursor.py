# SPDX-License-Identifier: Apache-2.0
"""The write position of a group of codes: a bank, and a place in it."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data

from ..frame_format import GROUP, FrameFormat


class BankCursor:
    """Counts groups within chunks, and chunks modulo the number of banks.

    Parameters
    ----------
    form : FrameFormat
        Sizes.
    """

    def __init__(self, form: FrameFormat) -> None:
        self.bank = Signal(range(form.banks))
        self.place = Signal(range(form.bank_groups))

    def advance(self, m: Module, valid: Value, end: Value, abort: Value, *, by: Value) -> None:
        """Move `by` groups on; a chunk's end begins the next bank, an abort the same one."""
        with m.If(valid):
            m.d.sync += self.place.eq(Mux(end, 0, self.place + by))
            with m.If(end & ~abort):
                m.d.sync += self.bank.eq(self.bank + 1)


def group_write_layout(form: FrameFormat, /) -> data.StructLayout:
    """Return the layout of a write to a memory of groups."""
    return data.StructLayout(
        {
            "bank": range(form.banks),
            "place": range(form.bank_groups),
            "codes": form.codes_layout(GROUP),
        }
    )
