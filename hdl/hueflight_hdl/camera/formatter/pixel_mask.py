# SPDX-License-Identifier: Apache-2.0
"""The memory of the pixel mask: written by the host, read with every beat."""

from __future__ import annotations

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out
from amaranth.utils import ceil_log2

from ..frame_format import FrameFormat
from .pixel_filter import MASK_WORD


class PixelMask(wiring.Component):
    """One bit per pixel in readout order, 1 = masked; all 0 after configuration.

    Members
    -------
    write, write_address, write_word : In
        From the host.
    host_address, host_word : In, Out
        Reading back, in one clock.
    address, word : In, Out
        For the filter, in one clock.
    """

    def __init__(self, form: FrameFormat) -> None:
        bits = ceil_log2(-(-form.pixels // MASK_WORD))
        self.words = 1 << bits
        super().__init__(
            {
                "write": In(1),
                "write_address": In(bits),
                "write_word": In(MASK_WORD),
                "host_address": In(bits),
                "host_word": Out(MASK_WORD),
                "address": In(bits),
                "word": Out(MASK_WORD),
            }
        )

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.memory = memory = Memory(shape=MASK_WORD, depth=self.words, init=[])
        save = memory.write_port()
        m.d.comb += [
            save.en.eq(self.write),
            save.addr.eq(self.write_address),
            save.data.eq(self.write_word),
        ]
        for address, word in ((self.host_address, self.host_word), (self.address, self.word)):
            load = memory.read_port()
            m.d.comb += [load.addr.eq(address), word.eq(load.data)]
        return m
